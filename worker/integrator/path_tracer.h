// The path tracer: radiance and features of pixels, by Embree. Sample i of pixel (x, y) is a pure
// function of (scene, settings, seed, x, y, i): the same bits for any thread, tile or range (C2).
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "core/base/pixel_rect.h"
#include "core/base/sample_range.h"
#include "core/film/tile_statistics.h"
#include "worker/scene/scene.h"

namespace tessera {

struct RenderSettings {
  int width = 640;  // of the frame
  int height = 360;
  int max_depth = 8;  // bounces after the camera hit
  // In place of max_depth: what longer paths may at most add to the picture's error; a pilot finds
  // the depth (depth_pilot.h). 0: max_depth holds.
  double depth_error = 0;
  uint64_t seed = 0;
  int64_t feature_end = kAllFeatures;  // samples below it carry features (TileStatistics)
  std::string isa = "x86-64-v3";
  int branches = 0;  // of paths at their first surface, 1 to 8; 0: as many as a pilot finds best
  int build_threads = 1;  // for Embree's BVH; moves no bit of the picture
};

struct RenderCounters {
  int64_t samples = 0;
  int64_t rays = 0;  // Embree queries, shadow rays included
  int64_t non_finite = 0;
  // Raised while samples are done, for those who watch from other threads; null = nobody does.
  std::atomic<int64_t>* samples_done = nullptr;
};

class PathTracer {
 public:
  // Builds acceleration structures and light samplers, with settings.build_threads threads; takes
  // the scene.
  // Errors: RESOURCE_EXHAUSTED (out of memory), FAILED_PRECONDITION (ISA class not on this
  // machine), INVALID_ARGUMENT (unknown ISA class).
  static absl::StatusOr<std::unique_ptr<PathTracer>> Create(std::unique_ptr<Scene> scene,
                                                            const RenderSettings& settings);
  ~PathTracer();

  // The statistics of one node of the folding tree over `window` (frame coordinates).
  // Errors: CANCELLED when `cancel` turns true (checked every few pixels; may be null).
  // Threads: const, any number at once; runs on the calling thread only.
  absl::StatusOr<TileStatistics> Render(const PixelRect& window, SampleRange node,
                                        const std::atomic<bool>* cancel,
                                        RenderCounters* counters) const;

  const Scene& scene() const;
  int branches() const;          // in use
  int max_depth() const;         // in use
  int64_t memory_bytes() const;  // scene and acceleration structures

 private:
  class Impl;
  explicit PathTracer(std::unique_ptr<Impl> impl);
  static absl::Status Build(std::unique_ptr<Scene> scene, Impl* impl);
  std::unique_ptr<Impl> impl_;
};

// ISA classes that this machine can run, widest first: "x86-64-v4", "x86-64-v3", "x86-64-v2".
std::vector<std::string> SupportedIsaClasses();

}  // namespace tessera
