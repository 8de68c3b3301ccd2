// The regression filter on a frame, stage by stage: prefiltered features, first pass, second pass,
// the blend and its error. What the first three make is kept, so that news make anew no more than
// each stage's own support around what has changed in the one before, and no stage is computed
// twice for neighbouring windows.
#pragma once

#include <array>
#include <cstdint>
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

  // A pass's result, and its centres on demand.
  struct Pass {
    PassPair runs;
    std::vector<uint8_t> on_demand;
  };
  // What differs in a pass from what was kept: rectangles around what has other bits, and around
  // pixels that have become centres on demand or are none any more.
  struct News {
    std::vector<PixelRect> values, centres;
  };

  void Allocate();
  // Makes what is stale of a stage over `reads`.
  void MakeStale(Stage stage, const FramePlanes& planes, const std::vector<PixelRect>& reads,
                 const ForEachPart& for_each_part);
  // Each makes a stage's kept planes over `rect` from those before it.
  void MakeFeatures(const FramePlanes& planes, const PixelRect& rect);
  void MakeFirst(const FramePlanes& planes, const PixelRect& rect, News* news);
  void MakeSecond(const FramePlanes& planes, const PixelRect& rect, News* news);
  void Make(Stage stage, const FramePlanes& planes, const PixelRect& rect, News* news);
  // Keeps a part of a pass and says what is new in it.
  News Keep(const PassOutputs& made, Pass* kept);
  // Says that a pass's fits change at `centres`.
  void MarkPass(Stage stage, const PixelRect& centres);
  // Makes stale what news in `stage` reach; `made` is not.
  void Spread(Stage stage, const std::vector<News>& news, const std::vector<PixelRect>& made);
  FilteredPlanes Finish(const FramePlanes& planes, const PixelRect& window) const;
  // The kept features over `rect`, zero where there are none.
  SmoothFeatures FeaturesOver(const PixelRect& rect) const;

  const RegressionSettings settings_;
  const PixelRect frame_;
  const PixelRect bounds_;  // all that is kept is row-major over it, empty before it is needed
  SmoothFeatures features_;
  Pass first_, second_;
  std::vector<StaleMask> stale_;  // by stage
};

}  // namespace tessera
