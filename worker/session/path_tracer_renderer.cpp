#include "worker/session/path_tracer_renderer.h"

#include <utility>

#include "worker/session/job_conversion.h"

namespace tessera {
namespace {

class PathTracerRenderer : public Renderer {
 public:
  explicit PathTracerRenderer(std::unique_ptr<PathTracer> tracer) : tracer_(std::move(tracer)) {}

  absl::StatusOr<TileStatistics> Render(const PixelRect& window, SampleRange node,
                                        const std::atomic<bool>* cancel,
                                        RenderCounters* counters) const override {
    return tracer_->Render(window, node, cancel, counters);
  }
  v1::SceneReport Report() const override {
    v1::SceneReport report = SceneReportOf(tracer_->scene(), tracer_->memory_bytes());
    report.set_max_depth(tracer_->max_depth());
    return report;
  }
  int64_t memory_bytes() const override { return tracer_->memory_bytes(); }
  int max_depth() const override { return tracer_->max_depth(); }

 private:
  std::unique_ptr<PathTracer> tracer_;
};

class PathTracerFactory : public RendererFactory {
 public:
  absl::StatusOr<std::unique_ptr<Renderer>> Build(const v1::JobSettings& settings,
                                                  int64_t memory_max_bytes, int threads,
                                                  const AssetReader& read_asset) override {
    absl::StatusOr<std::unique_ptr<Scene>> scene =
        LoadScene(SceneRequestOf(settings, memory_max_bytes), read_asset);
    if (!scene.ok()) return scene.status();
    absl::StatusOr<std::unique_ptr<PathTracer>> tracer =
        PathTracer::Create(*std::move(scene), RenderSettingsOf(settings, threads));
    if (!tracer.ok()) return tracer.status();
    return std::make_unique<PathTracerRenderer>(*std::move(tracer));
  }
};

}  // namespace

std::unique_ptr<RendererFactory> MakePathTracerFactory() {
  return std::make_unique<PathTracerFactory>();
}

}  // namespace tessera
