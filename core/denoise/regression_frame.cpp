#include "core/denoise/regression_frame.h"

#include <algorithm>

#include "core/base/check.h"
#include "core/base/tile_grid.h"
#include "core/denoise/box_sum.h"
#include "core/denoise/noise_probe.h"
#include "core/denoise/regression_input.h"
#include "core/denoise/regression_picture.h"
#include "core/statistics/calibration.h"

namespace tessera {
namespace {

// Sides of what is made at once: large against what is read around it, small against the memory of
// its scratch (some 200 bytes a pixel).
constexpr int kFeaturePartPx = 256;
constexpr int kPassPartPx = 256;
constexpr int kPicturePartPx = 128;

// Copies what of `rect` lies in both bounds.
void Copy(const PixelRect& from_bounds, const Plane& from, const PixelRect& rect,
          const PixelRect& to_bounds, Plane* to) {
  const PixelRect part = rect.Intersect(from_bounds).Intersect(to_bounds);
  if (part.empty()) return;
  for (int y = part.y_begin; y < part.y_end; ++y) {
    std::copy_n(from.begin() + from_bounds.IndexOf(part.x_begin, y), part.width(),
                to->begin() + to_bounds.IndexOf(part.x_begin, y));
  }
}

// The part of a pass's result over `rect`, zero beyond `from`.
PassOutput Part(const PassOutput& from, const PixelRect& rect) {
  PassOutput part;
  part.bounds = rect;
  for (size_t half = 0; half < kNumHalves; ++half) {
    for (size_t c = 0; c < 3; ++c) {
      part.color[half][c].resize(SlackArea(rect));
      Copy(from.bounds, from.color[half][c], rect, rect, &part.color[half][c]);
    }
  }
  return part;
}

void Keep(const PassOutput& made, PassOutput* kept) {
  for (size_t half = 0; half < kNumHalves; ++half) {
    for (size_t c = 0; c < 3; ++c) {
      Copy(made.bounds, made.color[half][c], made.bounds, kept->bounds, &kept->color[half][c]);
    }
  }
}

// The pilot over `bounds` from the first pass, whose parts `first` reach pilot_radius_px further.
// The probe's pilot has the variance of the samples' own: the probe moves it by little, and one
// variance halves the work of finding both pilots' weights.
Pilot MakePilot(const RegressionInput& input, const PassPair& first,
                const RegressionSettings& settings, const PixelRect& bounds) {
  const int radius_px = settings.pilot_radius_px;
  Pilot pilot;
  pilot.bounds = bounds;
  const PixelRect& read = first[0].bounds;
  Plane known(static_cast<size_t>(read.area()));
  Planes3 variance;
  for (size_t c = 0; c < 3; ++c) {
    for (Planes3& color : pilot.color) color[c].resize(SlackArea(bounds));
    variance[c].resize(known.size());
  }
  size_t i = 0;
  for (int y = read.y_begin; y < read.y_end; ++y) {
    auto p = static_cast<size_t>(input.bounds.IndexOf(read.x_begin, y));
    for (int x = read.x_begin; x < read.x_end; ++x, ++i, ++p) {
      if (input.known[p] == 0) continue;
      known[i] = 1;
      const float share_a = input.share_a[p];
      const float share_b = 1.0f - share_a;
      for (size_t c = 0; c < 3; ++c) {
        const float difference = first[0].color[0][c][i] - first[0].color[1][c][i];
        variance[c][i] = share_a * share_b * (difference * difference) +
                         settings.raw_share * input.variance[c][p];
        if (!bounds.Contains(x, y)) continue;
        const auto to = static_cast<size_t>(bounds.IndexOf(x, y));
        for (size_t run = 0; run < kNumRuns; ++run) {
          pilot.color[run][c][to] =
              share_a * first[run].color[0][c][i] + share_b * first[run].color[1][c][i];
        }
      }
    }
  }
  const Plane count = BoxSum(known, read, radius_px, bounds, kRowSlackPx);
  for (size_t c = 0; c < 3; ++c) {
    pilot.variance[c] = BoxSum(variance[c], read, radius_px, bounds, kRowSlackPx);
    for (size_t k = 0; k < count.size(); ++k) {
      pilot.variance[c][k] =
          count[k] > 0 ? std::max(pilot.variance[c][k] / count[k], 1e-30f) : 1.0f;
    }
  }
  return pilot;
}

}  // namespace

RegressionFrame::RegressionFrame(const RegressionSettings& settings, const PixelRect& frame,
                                 const PixelRect& bounds)
    : settings_(settings),
      frame_(frame),
      bounds_(bounds.Intersect(frame)),
      stale_(kNumStages, StaleMask(bounds_)) {}

int RegressionFrame::reach_px() const {
  return std::max(settings_.reach_px(), kCalibrationRadiusPx);
}

int64_t RegressionFrame::kept_bytes() const {
  int64_t bytes = 0;
  for (const StaleMask& mask : stale_) bytes += mask.bytes();
  const auto add = [&](const auto& planes) {
    for (const Plane& plane : planes) bytes += static_cast<int64_t>(sizeof(float) * plane.size());
  };
  add(features_.value);
  add(features_.variance);
  for (const PassPair* pair : {&first_, &second_}) {
    for (const PassOutput& run : *pair) {
      for (const Planes3& color : run.color) add(color);
    }
  }
  return bytes;
}

void RegressionFrame::Allocate() {
  if (features_.bounds == bounds_) return;
  const auto area = static_cast<size_t>(bounds_.area());
  features_.bounds = bounds_;
  for (Plane& plane : features_.value) plane.resize(area);
  for (Plane& plane : features_.variance) plane.resize(area);
  for (PassPair* pair : {&first_, &second_}) {
    for (PassOutput& run : *pair) {
      run.bounds = bounds_;
      for (Planes3& color : run.color) {
        for (Plane& plane : color) plane.resize(area);
      }
    }
  }
}

void RegressionFrame::Invalidate(const PixelRect& changed) {
  stale_[kFeatures].Mark(changed.Expand(settings_.feature_news_px()));
  stale_[kFirst].Mark(changed.Expand(settings_.first_news_px()));
  stale_[kSecond].Mark(changed.Expand(settings_.second_news_px()));
}

void RegressionFrame::Filter(const FramePlanes& planes, std::span<const PixelRect> windows,
                             const ForEachPart& for_each_part,
                             const std::function<void(const FilteredPlanes& part)>& put) {
  struct Plan {
    int around_px;  // the windows
    int part_px;
    int border_px;  // that a part costs beside itself
  };
  const int second_px = settings_.picture_reach_px();
  const int first_px = second_px + settings_.first_of_second_px();
  const int features_px = first_px + settings_.pass_reach_px();
  const int sums_px = settings_.pass_reach_px() - settings_.window_radius_px;
  const std::array<Plan, kNumStages> plans = {
      Plan{features_px, kFeaturePartPx, settings_.feature_news_px()},
      Plan{first_px, kPassPartPx, sums_px}, Plan{second_px, kPassPartPx, sums_px}};
  Allocate();
  for (size_t stage = 0; stage < kNumStages; ++stage) {
    const Plan& plan = plans[stage];
    std::vector<PixelRect> parts;
    for (const PixelRect& window : windows) {
      const PixelRect read = window.Expand(plan.around_px).Intersect(frame_);
      TESSERA_CHECK(window.empty() || bounds_.Contains(read));
      stale_[stage].Take(read, plan.part_px, plan.border_px, &parts);
    }
    for_each_part(parts.size(),
                  [&](size_t i) { Make(static_cast<Stage>(stage), planes, parts[i]); });
  }
  const std::vector<PixelRect> parts = SplitWindows(windows, kPicturePartPx);
  for_each_part(parts.size(), [&](size_t i) { put(Finish(planes, parts[i])); });
}

void RegressionFrame::Make(Stage stage, const FramePlanes& planes, const PixelRect& rect) {
  switch (stage) {
    case kFeatures: return MakeFeatures(planes, rect);
    case kFirst: return MakeFirst(planes, rect);
    default: return MakeSecond(planes, rect);
  }
}

void RegressionFrame::MakeFeatures(const FramePlanes& planes, const PixelRect& rect) {
  const RawFeatures raw(rect.Expand(settings_.feature_news_px()), frame_, planes);
  const SmoothFeatures made = PrefilterFeatures(raw, rect, settings_.prefilter_radius_px);
  for (size_t k = 0; k < kNumFeatures; ++k) {
    Copy(rect, made.value[k], rect, bounds_, &features_.value[k]);
    Copy(rect, made.variance[k], rect, bounds_, &features_.variance[k]);
  }
}

SmoothFeatures RegressionFrame::FeaturesOver(const PixelRect& rect) const {
  SmoothFeatures part;
  part.bounds = rect;
  for (size_t k = 0; k < kNumFeatures; ++k) {
    part.value[k].resize(SlackArea(rect));
    part.variance[k].resize(SlackArea(rect));
    Copy(bounds_, features_.value[k], rect, rect, &part.value[k]);
    Copy(bounds_, features_.variance[k], rect, rect, &part.variance[k]);
  }
  return part;
}

void RegressionFrame::MakeFirst(const FramePlanes& planes, const PixelRect& rect) {
  const SmoothFeatures features = FeaturesOver(rect.Expand(settings_.pass_reach_px()));
  RegressionInput input(rect.Expand(settings_.pass_reach_px() + 1), frame_, planes,
                        settings_.outlier_ratio);
  const ColorHalves color = input.color;
  Probe(settings_.probe_step, &input);
  const ColorHalves* const colors[] = {&color, &input.color};
  const std::vector<PassOutput> made =
      RunCrossPasses(input, colors, features, {frame_, rect, settings_});
  for (size_t run = 0; run < kNumRuns; ++run) Keep(made[run], &first_[run]);
}

void RegressionFrame::MakeSecond(const FramePlanes& planes, const PixelRect& rect) {
  const SmoothFeatures features = FeaturesOver(rect.Expand(settings_.pass_reach_px()));
  RegressionInput input(rect.Expand(settings_.first_of_second_px()), frame_, planes,
                        settings_.outlier_ratio);
  const Pilot pilot =
      MakePilot(input, {Part(first_[0], input.bounds), Part(first_[1], input.bounds)}, settings_,
                rect.Expand(settings_.pass_reach_px() + 1));
  const ColorHalves color = input.color;
  Probe(settings_.probe_step, &input);
  const ColorHalves* const colors[] = {&color, &input.color};
  const std::vector<PassOutput> made =
      RunPilotPasses(input, colors, features, pilot, 1, {frame_, rect, settings_});
  for (size_t run = 0; run < kNumRuns; ++run) Keep(made[run], &second_[run]);
}

FilteredPlanes RegressionFrame::Finish(const FramePlanes& planes, const PixelRect& window) const {
  const PixelRect read = window.Expand(settings_.picture_reach_px());
  std::array<Candidates, kNumRuns> candidates;
  for (size_t run = 0; run < kNumRuns; ++run) {
    candidates[run] = {Part(first_[run], read), Part(second_[run], read)};
  }
  return BlendAndJudge(planes, frame_, candidates[0], candidates[1], window, settings_);
}

}  // namespace tessera
