// What a session needs of a renderer: build a scene once, render nodes of the folding tree on any
// number of threads. The path tracer implements it (path_tracer_renderer.h); tests use a fake.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>

#include "absl/status/statusor.h"
#include "core/base/pixel_rect.h"
#include "core/base/sample_range.h"
#include "core/film/tile_statistics.h"
#include "tessera/v1/job.pb.h"
#include "worker/integrator/path_tracer.h"
#include "worker/scene/scene_loader.h"

namespace tessera {

class Renderer {
 public:
  virtual ~Renderer() = default;

  // Errors: CANCELLED once `cancel` is true. Threads: any number at once.
  virtual absl::StatusOr<TileStatistics> Render(const PixelRect& window, SampleRange node,
                                                const std::atomic<bool>* cancel,
                                                RenderCounters* counters) const = 0;
  // What the server tells its users about the scene; load_seconds is the caller's to fill.
  virtual v1::SceneReport Report() const = 0;
  virtual int64_t memory_bytes() const = 0;
  // Of every path, bounces after the camera hit: as in Report().
  virtual int max_depth() const = 0;
};

class RendererFactory {
 public:
  virtual ~RendererFactory() = default;

  // Builds the scene of `settings` on `threads` threads within memory_max_bytes (0 = unlimited).
  // Errors: RESOURCE_EXHAUSTED  the scene needs more memory
  //         FAILED_PRECONDITION this machine cannot run the job's ISA class
  //         others              the scene is wrong, in one line for its user
  virtual absl::StatusOr<std::unique_ptr<Renderer>> Build(const v1::JobSettings& settings,
                                                          int64_t memory_max_bytes, int threads,
                                                          const AssetReader& read_asset) = 0;
};

}  // namespace tessera
