// A filter on one frame whose planes change bit by bit: what it makes on the way to the picture may
// be kept, so that news make anew only what they reach. Kept or not, the bits are the same.
#pragma once

#include <cstdint>
#include <functional>
#include <span>

#include "core/denoise/denoiser.h"

namespace tessera {

// Calls body(0) ... body(count - 1), each once, on any threads, and returns when all have.
using ForEachPart = std::function<void(size_t count, const std::function<void(size_t)>& body)>;

// What any filter keeps for each pixel of its frame, at most: what budgets of memory count with.
inline constexpr int64_t kKeptBytesPerPixelMax = 160;

// Threads: one call at a time.
class FrameFilter {
 public:
  virtual ~FrameFilter() = default;
  // Pixels around news in the planes (but for planes.variance, which follows from the others) that
  // the news can change.
  virtual int reach_px() const = 0;
  // Says that the planes have changed within `changed` since they were last filtered.
  virtual void Invalidate(const PixelRect& changed) = 0;
  // Filters `windows`, which are disjoint and lie in the frame. planes.bounds must contain each
  // window expanded by the denoiser's halo and cut at the frame. Calls put(part) for disjoint parts
  // that cover the windows, from the threads of for_each_part.
  virtual void Filter(const FramePlanes& planes, std::span<const PixelRect> windows,
                      const ForEachPart& for_each_part,
                      const std::function<void(const FilteredPlanes& part)>& put) = 0;
  // What is kept between calls; at most kKeptBytesPerPixelMax for each pixel.
  virtual int64_t kept_bytes() const = 0;
};

// Keeps nothing: each window is filtered by itself.
class WindowFilter final : public FrameFilter {
 public:
  // `denoiser` must outlive it.
  WindowFilter(const Denoiser& denoiser, const FrameParameters& parameters)
      : denoiser_(denoiser), parameters_(parameters) {}

  int reach_px() const override;
  void Invalidate(const PixelRect& /*changed*/) override {}
  void Filter(const FramePlanes& planes, std::span<const PixelRect> windows,
              const ForEachPart& for_each_part,
              const std::function<void(const FilteredPlanes& part)>& put) override;
  int64_t kept_bytes() const override { return 0; }

 private:
  const Denoiser& denoiser_;
  const FrameParameters parameters_;
};

}  // namespace tessera
