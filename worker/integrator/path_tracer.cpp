#include "worker/integrator/path_tracer.h"

#include <tbb/global_control.h>

#include <algorithm>
#include <array>
#include <new>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/check.h"
#include "core/film/pixel_folder.h"
#include "core/film/pixel_sample.h"
#include "worker/integrator/ablation.h"
#include "worker/integrator/branch_pilot.h"
#include "worker/integrator/depth_pilot.h"
#include "worker/integrator/light_guide.h"
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
  std::unique_ptr<LightGuide> guide;  // null where there is nothing to learn
  std::unique_ptr<CameraRays> camera;
  std::unique_ptr<const NestedSolids> solids;  // null where none overlap
  std::unique_ptr<PathWalker> walker;
  int branches = 1;
  int max_depth = 0;
};

PathTracer::PathTracer(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
PathTracer::~PathTracer() = default;

absl::StatusOr<std::unique_ptr<PathTracer>> PathTracer::Create(std::unique_ptr<Scene> scene,
                                                               const RenderSettings& settings) {
  // Embree's own `threads=` would hold down all of TBB for as long as its device lives.
  tbb::global_control threads(tbb::global_control::max_allowed_parallelism,
                              static_cast<size_t>(std::max(1, settings.build_threads)));
  auto impl = std::make_unique<Impl>();
  impl->settings = settings;
  try {
    if (absl::Status status = Build(std::move(scene), impl.get()); !status.ok()) return status;
  } catch (const std::bad_alloc&) {
    return absl::ResourceExhaustedError(
        "out of memory while the scene is built; reduce the scene or use a machine with more "
        "memory");
  }
  return std::unique_ptr<PathTracer>(new PathTracer(std::move(impl)));
}

absl::Status PathTracer::Build(std::unique_ptr<Scene> scene, Impl* impl) {
  const RenderSettings& settings = impl->settings;
  TESSERA_CHECK(settings.branches >= 0 && settings.branches <= kBranchesMax &&
                (settings.branches & (settings.branches - 1)) == 0);
  impl->scene = std::move(scene);
  Scene* s = impl->scene.get();
  impl->geometries = PlaceInstances(s);
  impl->surfaces = std::make_unique<SurfaceReader>(*s, impl->geometries);
  auto embree = EmbreeScene::Create(s, *impl->surfaces, settings.isa);
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
  if (Steps().guide &&
      (impl->lights->has_group(kEnvironmentGroup) || impl->lights->num_groups() > 1)) {
    impl->guide =
        LightGuide::Learn({*impl->surfaces, *impl->embree, *impl->lights, impl->environment.get(),
                           *impl->camera, settings.width, settings.height});
    impl->lights->SetGuide(impl->guide.get());
  }
  PathWalker::Parts parts{*impl->surfaces, *impl->embree, impl->environment.get(),
                          *impl->lights,   *impl->camera, settings.max_depth};
  impl->solids = NestedSolids::Find(*s, *impl->surfaces);
  parts.solids = impl->solids.get();
  if (!Steps().mis) parts.strategy = LightStrategy::kLightsOnly;
  if (!Steps().second_light_sample) parts.first_light_samples = 1;
  parts.has_roulette = Steps().roulette;
  if (settings.depth_error > 0) {
    parts.max_depth = FindDepth(parts, settings.width, settings.height, settings.depth_error);
  }
  impl->max_depth = parts.max_depth;
  parts.branches = settings.branches;
  if (!Steps().splitting) parts.branches = 1;
  if (parts.branches == 0) parts.branches = ChooseBranches(parts, settings.width, settings.height);
  impl->branches = parts.branches;
  impl->walker = std::make_unique<PathWalker>(parts);
  return absl::OkStatus();
}

namespace {

// Folds samples that arrive pixel by pixel, row by row, into a tile.
class TileFolder {
 public:
  explicit TileFolder(TileStatistics* tile)
      : tile_(*tile), x_(tile->window().x_begin), y_(tile->window().y_begin) {}

  void Add(PixelSample* sample) {
    if (num_added_ == 0) folder_.Begin(x_, y_, tile_.range(), tile_.feature_end());
    if (ReplaceNonFinite(sample)) ++tile_.non_finite;
    folder_.Add(*sample);
    if (++num_added_ < tile_.range().size()) return;
    folder_.Store(&tile_);
    num_added_ = 0;
    if (++x_ < tile_.window().x_end) return;
    x_ = tile_.window().x_begin;
    ++y_;
  }

 private:
  TileStatistics& tile_;
  int x_, y_;  // the pixel that is being folded
  int64_t num_added_ = 0;
  PixelFolder folder_;
};

// Paths that wait until they are enough to be walked at once. The samples of a pixel are a power of
// two, as is kSamplesMax: the queue holds some of one pixel's or all of several pixels'.
class PathQueue {
 public:
  // samples_done: as RenderCounters.
  PathQueue(const PathWalker& walker, uint64_t seed, TileStatistics* tile,
            std::atomic<int64_t>* samples_done)
      : walker_(walker),
        seed_(seed),
        feature_end_(tile->feature_end()),
        samples_done_(samples_done),
        tile_(tile) {}

  // Begins a pixel, whose samples follow.
  void BeginPixel(int x, int y) {
    x_ = x;
    y_ = y;
    pixel_ = num_paths_ == 0 ? 0 : pixel_ + 1;
    for (int half = 0; half < kNumHalves; ++half) {
      seeds_[pixel_][half].Begin(SobolSampler::SequenceKey(seed_, x, y, half));
    }
  }

  void Add(int64_t sample) {
    SequenceSeeds* seeds = &seeds_[pixel_][sample & 1];
    requests_[num_paths_++] = {SobolSampler(seeds->key(), sample), seeds, x_, y_,
                               sample < feature_end_};
    if (num_paths_ == PathWalker::kSamplesMax) Flush();
  }

  void Flush() {
    const auto count = static_cast<size_t>(num_paths_);
    walker_.Trace({requests_.data(), count}, {samples_.data(), count}, &rays_);
    for (int i = 0; i < num_paths_; ++i) tile_.Add(&samples_[i]);
    if (samples_done_ != nullptr) samples_done_->fetch_add(num_paths_, std::memory_order_relaxed);
    num_paths_ = 0;
  }

  int64_t rays() const { return rays_; }

 private:
  const PathWalker& walker_;
  const uint64_t seed_;
  const int64_t feature_end_;
  std::atomic<int64_t>* const samples_done_;
  TileFolder tile_;
  int x_ = 0, y_ = 0, pixel_ = 0;
  int num_paths_ = 0;
  int64_t rays_ = 0;
  std::array<PathRequest, PathWalker::kSamplesMax> requests_;
  std::array<PixelSample, PathWalker::kSamplesMax> samples_;
  std::array<std::array<SequenceSeeds, kNumHalves>, PathWalker::kSamplesMax> seeds_;
};

}  // namespace

absl::StatusOr<TileStatistics> PathTracer::Render(const PixelRect& window, SampleRange node,
                                                  const std::atomic<bool>* cancel,
                                                  RenderCounters* counters) const {
  if (!node.IsNode()) {
    return absl::InvalidArgumentError(
        absl::StrCat("samples [", node.begin, ", ", node.end, ") are no node of the folding tree"));
  }
  TileStatistics tile(window, node, impl_->settings.feature_end);
  PathQueue queue(*impl_->walker, impl_->settings.seed, &tile,
                  counters != nullptr ? counters->samples_done : nullptr);
  for (int y = window.y_begin; y < window.y_end; ++y) {
    for (int x = window.x_begin; x < window.x_end; ++x) {
      if (cancel != nullptr && cancel->load(std::memory_order_relaxed)) {
        return absl::CancelledError("rendering was cancelled");
      }
      queue.BeginPixel(x, y);
      for (int64_t i = node.begin; i < node.end; ++i) queue.Add(i);
    }
  }
  queue.Flush();
  if (counters != nullptr) {
    counters->samples += window.area() * node.size();
    counters->rays += queue.rays();
    counters->non_finite += tile.non_finite;
  }
  return tile;
}

const Scene& PathTracer::scene() const { return *impl_->scene; }
int PathTracer::branches() const { return impl_->branches; }
int PathTracer::max_depth() const { return impl_->max_depth; }

int64_t PathTracer::memory_bytes() const {
  int64_t bytes = impl_->scene->memory_bytes() + impl_->embree->memory_bytes() +
                  impl_->lights->memory_bytes() + impl_->surfaces->memory_bytes();
  if (impl_->environment != nullptr) bytes += impl_->environment->memory_bytes();
  if (impl_->guide != nullptr) bytes += impl_->guide->memory_bytes();
  return bytes;
}

}  // namespace tessera
