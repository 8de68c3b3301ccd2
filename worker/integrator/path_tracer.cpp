#include "worker/integrator/path_tracer.h"

#include <array>
#include <limits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/film/pixel_folder.h"
#include "core/film/pixel_sample.h"
#include "worker/integrator/path_walker.h"
#include "worker/integrator/sobol_sampler.h"

namespace tessera {

class PathTracer::Impl {
 public:
  std::unique_ptr<Scene> scene;
  RenderSettings settings;
  std::vector<InstanceGeometry> geometries;
  std::unique_ptr<SurfaceReader> surfaces;
  std::unique_ptr<EmbreeScene> embree;
  std::unique_ptr<EnvironmentSampler> environment;  // null without one
  std::unique_ptr<LightSampler> lights;
  std::unique_ptr<CameraRays> camera;
  std::unique_ptr<PathWalker> walker;
};

PathTracer::PathTracer(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
PathTracer::~PathTracer() = default;

absl::StatusOr<std::unique_ptr<PathTracer>> PathTracer::Create(std::unique_ptr<Scene> scene,
                                                               const RenderSettings& settings) {
  auto impl = std::make_unique<Impl>();
  impl->settings = settings;
  impl->scene = std::move(scene);
  Scene* s = impl->scene.get();
  impl->geometries = PlaceInstances(s);
  impl->surfaces = std::make_unique<SurfaceReader>(*s, impl->geometries);
  auto embree = EmbreeScene::Create(s, *impl->surfaces, settings.isa, settings.build_threads);
  if (!embree.ok()) return embree.status();
  impl->embree = *std::move(embree);
  if (s->environment.has_value()) {
    impl->environment = std::make_unique<EnvironmentSampler>(&*s->environment);
  }
  const Imath::Box3f bounds = impl->embree->bounds();
  const float radius = bounds.isEmpty() ? 1.f : 0.5f * bounds.size().length();
  impl->lights =
      std::make_unique<LightSampler>(*s, *impl->surfaces, impl->environment.get(), radius);
  impl->camera = std::make_unique<CameraRays>(s->camera, settings.width, settings.height);
  impl->walker = std::make_unique<PathWalker>(
      PathWalker::Parts{*impl->surfaces, *impl->embree, impl->environment.get(), *impl->lights,
                        *impl->camera, settings.max_depth});
  return std::unique_ptr<PathTracer>(new PathTracer(std::move(impl)));
}

absl::StatusOr<TileStatistics> PathTracer::Render(const PixelRect& window, SampleRange node,
                                                  const std::atomic<bool>* cancel,
                                                  RenderCounters* counters) const {
  if (!node.IsNode()) {
    return absl::InvalidArgumentError(
        absl::StrCat("samples [", node.begin, ", ", node.end, ") are no node of the folding tree"));
  }
  TileStatistics tile(window, node);
  PixelFolder folder;
  RenderCounters count;
  for (int y = window.y_begin; y < window.y_end; ++y) {
    for (int x = window.x_begin; x < window.x_end; ++x) {
      if (cancel != nullptr && cancel->load(std::memory_order_relaxed)) {
        return absl::CancelledError("rendering was cancelled");
      }
      std::array<uint64_t, kNumHalves> keys;
      for (int half = 0; half < kNumHalves; ++half) {
        keys[half] = SobolSampler::SequenceKey(impl_->settings.seed, x, y, half);
      }
      folder.Begin(node);
      for (int64_t i = node.begin; i < node.end; ++i) {
        const SobolSampler sampler(keys[i & 1], i);
        PixelSample sample = impl_->walker->Trace(sampler, x, y, &count.rays);
        if (ReplaceNonFinite(&sample)) ++tile.non_finite;
        folder.Add(sample);
      }
      folder.Store(x, y, &tile);
    }
  }
  if (counters != nullptr) {
    counters->samples += window.area() * node.size();
    counters->rays += count.rays;
    counters->non_finite += tile.non_finite;
  }
  return tile;
}

const Scene& PathTracer::scene() const { return *impl_->scene; }

int64_t PathTracer::memory_bytes() const {
  int64_t bytes =
      impl_->scene->memory_bytes() + impl_->embree->memory_bytes() + impl_->lights->memory_bytes();
  if (impl_->environment != nullptr) bytes += impl_->environment->memory_bytes();
  return bytes;
}

}  // namespace tessera
