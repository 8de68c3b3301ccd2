// The regression filter on a frame, stage by stage: prefiltered features, first pass, second pass,
// the blend and its error. What the first three make is kept, so that news make anew no more than
// each stage's own support around them, and no stage is computed twice for neighbouring windows.
#pragma once

#include <array>
#include <vector>

#include "core/denoise/feature_prefilter.h"
#include "core/denoise/frame_filter.h"
#include "core/denoise/regression_pass.h"
#include "core/denoise/stale_mask.h"

namespace tessera {

// A pass's result from the samples, and from the samples shaken by the probe of the noise.
inline constexpr size_t kNumRuns = 2;
using PassPair = std::array<PassOutput, kNumRuns>;

class RegressionFrame final : public FrameFilter {
 public:
  // Keeps planes over what of `bounds` lies in `frame`: at least each window that is to be filtered
  // expanded by settings.reach_px() and cut at the frame.
  RegressionFrame(const RegressionSettings& settings, const PixelRect& frame,
                  const PixelRect& bounds);

  int reach_px() const override;
  void Invalidate(const PixelRect& changed) override;
  void Filter(const FramePlanes& planes, std::span<const PixelRect> windows,
              const ForEachPart& for_each_part,
              const std::function<void(const FilteredPlanes& part)>& put) override;
  int64_t kept_bytes() const override;

 private:
  enum Stage { kFeatures, kFirst, kSecond, kNumStages };

  void Allocate();
  // Each makes a stage's kept planes over `rect` from those before it.
  void MakeFeatures(const FramePlanes& planes, const PixelRect& rect);
  void MakeFirst(const FramePlanes& planes, const PixelRect& rect);
  void MakeSecond(const FramePlanes& planes, const PixelRect& rect);
  void Make(Stage stage, const FramePlanes& planes, const PixelRect& rect);
  FilteredPlanes Finish(const FramePlanes& planes, const PixelRect& window) const;
  // The kept features over `rect`, zero where there are none.
  SmoothFeatures FeaturesOver(const PixelRect& rect) const;

  const RegressionSettings settings_;
  const PixelRect frame_;
  const PixelRect bounds_;  // all that is kept is row-major over it, empty before it is needed
  SmoothFeatures features_;
  PassPair first_, second_;
  std::vector<StaleMask> stale_;  // by stage
};

}  // namespace tessera
