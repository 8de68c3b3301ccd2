#include "core/denoise/regression_frame.h"

#include <algorithm>
#include <bit>

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
// its scratch: some 200 bytes a pixel, of the picture 400. The picture's is what news in a tile of
// 64x64 reach.
constexpr int kFeaturePartPx = 256;
constexpr int kPassPartPx = 256;
constexpr int kPicturePartPx = 208;

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

// Rectangles of at most this side tell where a pass has other bits than were kept.
constexpr int kNewsPx = 8;

// The smallest rectangle around the pixels of `rect` where the planes have other bits; empty if
// there are none.
PixelRect Differing(const PassOutput& made, const PassOutput& kept, const PixelRect& rect) {
  PixelRect found{rect.x_end, rect.y_end, rect.x_begin, rect.y_begin};
  for (size_t half = 0; half < kNumHalves; ++half) {
    for (size_t c = 0; c < 3; ++c) {
      for (int y = rect.y_begin; y < rect.y_end; ++y) {
        const float* const now = &made.color[half][c][static_cast<size_t>(
            made.bounds.IndexOf(rect.x_begin, y))];
        const float* const before = &kept.color[half][c][static_cast<size_t>(
            kept.bounds.IndexOf(rect.x_begin, y))];
        for (int x = 0; x < rect.width(); ++x) {
          if (std::bit_cast<uint32_t>(now[x]) == std::bit_cast<uint32_t>(before[x])) continue;
          found = {std::min(found.x_begin, rect.x_begin + x), std::min(found.y_begin, y),
                   std::max(found.x_end, rect.x_begin + x + 1), std::max(found.y_end, y + 1)};
        }
      }
    }
  }
  return found;
}

PixelRect Around(const PixelRect& a, const PixelRect& b) {
  return {std::min(a.x_begin, b.x_begin), std::min(a.y_begin, b.y_begin),
          std::max(a.x_end, b.x_end), std::max(a.y_end, b.y_end)};
}

// Calls body(rect) for cells of at most kNewsPx wide and high that cover `bounds`.
template <typename Body>
void ForEachCell(const PixelRect& bounds, const Body& body) {
  for (int y = bounds.y_begin; y < bounds.y_end; y += kNewsPx) {
    for (int x = bounds.x_begin; x < bounds.x_end; x += kNewsPx) {
      body(PixelRect::FromSize(x, y, kNewsPx, kNewsPx).Intersect(bounds));
    }
  }
}

void CopyRuns(const std::vector<PassOutput>& made, PassPair* kept) {
  for (size_t run = 0; run < kNumRuns; ++run) {
    for (size_t half = 0; half < kNumHalves; ++half) {
      for (size_t c = 0; c < 3; ++c) {
        Copy(made[run].bounds, made[run].color[half][c], made[run].bounds, (*kept)[run].bounds,
             &(*kept)[run].color[half][c]);
      }
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
  for (const Pass* pass : {&first_, &second_}) {
    bytes += static_cast<int64_t>(pass->on_demand.size());
    for (const PassOutput& run : pass->runs) {
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
  for (Pass* pass : {&first_, &second_}) {
    pass->on_demand.resize(area);
    for (PassOutput& run : pass->runs) {
      run.bounds = bounds_;
      for (Planes3& color : run.color) {
        for (Plane& plane : color) plane.resize(area);
      }
    }
  }
}

void RegressionFrame::Invalidate(const PixelRect& changed) {
  stale_[kFeatures].Mark(changed.Expand(settings_.feature_news_px()));
  MarkPass(kFirst, changed.Expand(settings_.first_centre_news_px()));
  MarkPass(kSecond, changed.Expand(settings_.second_centre_plane_news_px()));
}

void RegressionFrame::MarkPass(Stage stage, const PixelRect& centres) {
  const PixelRect predicted = PredictedFrom(centres, frame_, settings_);
  if (predicted.empty()) return;
  stale_[stage].Mark(predicted);
  stale_[stage].Doubt(predicted.Expand(settings_.on_demand_news_px()));
}

void RegressionFrame::Filter(const FramePlanes& planes, std::span<const PixelRect> windows,
                             const ForEachPart& for_each_part,
                             const std::function<void(const FilteredPlanes& part)>& put) {
  const int second_px = settings_.picture_reach_px();
  const int first_px = second_px + settings_.first_of_second_px();
  const std::array<int, kNumStages> around_px = {first_px + settings_.pass_reach_px(), first_px,
                                                 second_px};
  Allocate();
  for (size_t stage = 0; stage < kNumStages; ++stage) {
    std::vector<PixelRect> reads;
    for (const PixelRect& window : windows) {
      if (window.empty()) continue;
      reads.push_back(window.Expand(around_px[stage]).Intersect(frame_));
      TESSERA_CHECK(bounds_.Contains(reads.back()));
    }
    MakeStale(static_cast<Stage>(stage), planes, reads, for_each_part);
  }
  const std::vector<PixelRect> parts = SplitWindows(windows, kPicturePartPx);
  for_each_part(parts.size(), [&](size_t i) { put(Finish(planes, parts[i])); });
}

void RegressionFrame::MakeStale(Stage stage, const FramePlanes& planes,
                                const std::vector<PixelRect>& reads,
                                const ForEachPart& for_each_part) {
  StaleMask& stale = stale_[stage];
  const bool is_pass = stage != kFeatures;
  const int part_px = is_pass ? kPassPartPx : kFeaturePartPx;
  // That a part costs beside itself.
  const int border_px = is_pass ? settings_.pass_reach_px() - settings_.window_radius_px
                                : settings_.feature_news_px();
  std::vector<PixelRect> made;
  for (bool is_settled = false;;) {
    std::vector<PixelRect> parts;
    for (const PixelRect& read : reads) stale.Take(read, part_px, border_px, &parts);
    if (parts.empty()) {
      if (is_settled) return;
      for (const PixelRect& read : reads) stale.Settle(read, settings_.on_demand_news_px());
      is_settled = true;
      continue;
    }
    std::vector<News> news(parts.size());
    for_each_part(parts.size(), [&](size_t i) { Make(stage, planes, parts[i], &news[i]); });
    made.insert(made.end(), parts.begin(), parts.end());
    Spread(stage, news, made);
  }
}

void RegressionFrame::Spread(Stage stage, const std::vector<News>& news,
                             const std::vector<PixelRect>& made) {
  for (const News& part : news) {
    for (const PixelRect& rect : part.centres) {
      stale_[stage].Mark(rect.Expand(settings_.on_demand_news_px()));
    }
    if (stage != kFirst) continue;
    for (const PixelRect& rect : part.values) {
      MarkPass(kSecond, rect.Expand(settings_.second_centre_news_px()));
    }
  }
  for (const PixelRect& rect : made) stale_[stage].Clear(rect);
}

void RegressionFrame::Make(Stage stage, const FramePlanes& planes, const PixelRect& rect,
                           News* news) {
  switch (stage) {
    case kFeatures: return MakeFeatures(planes, rect);
    case kFirst: return MakeFirst(planes, rect, news);
    default: return MakeSecond(planes, rect, news);
  }
}

RegressionFrame::News RegressionFrame::Keep(const PassOutputs& made, Pass* kept) {
  const PixelRect& bounds = made.runs[0].bounds;
  News news;
  ForEachCell(bounds, [&](const PixelRect& cell) {
    PixelRect centres{cell.x_end, cell.y_end, cell.x_begin, cell.y_begin};
    for (int y = cell.y_begin; y < cell.y_end; ++y) {
      for (int x = cell.x_begin; x < cell.x_end; ++x) {
        const uint8_t now = made.on_demand[static_cast<size_t>(bounds.IndexOf(x, y))];
        uint8_t& before = kept->on_demand[static_cast<size_t>(bounds_.IndexOf(x, y))];
        if (now != before) centres = Around(centres, PixelRect::FromSize(x, y, 1, 1));
        before = now;
      }
    }
    if (!centres.empty()) news.centres.push_back(centres);
    const PixelRect values = Around(Differing(made.runs[0], kept->runs[0], cell),
                                    Differing(made.runs[1], kept->runs[1], cell));
    if (!values.empty()) news.values.push_back(values);
  });
  CopyRuns(made.runs, &kept->runs);
  return news;
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

void RegressionFrame::MakeFirst(const FramePlanes& planes, const PixelRect& rect, News* news) {
  const SmoothFeatures features = FeaturesOver(rect.Expand(settings_.pass_reach_px()));
  RegressionInput input(rect.Expand(settings_.pass_reach_px() + 1), frame_, planes,
                        settings_.outlier_ratio);
  const ColorHalves color = input.color;
  Probe(settings_.probe_step, &input);
  const ColorHalves* const colors[] = {&color, &input.color};
  *news = Keep(RunCrossPasses(input, colors, features, {frame_, rect, settings_}), &first_);
}

void RegressionFrame::MakeSecond(const FramePlanes& planes, const PixelRect& rect,
                                 News* news) {
  const SmoothFeatures features = FeaturesOver(rect.Expand(settings_.pass_reach_px()));
  RegressionInput input(rect.Expand(settings_.first_of_second_px()), frame_, planes,
                        settings_.outlier_ratio);
  const Pilot pilot =
      MakePilot(input, {Part(first_.runs[0], input.bounds), Part(first_.runs[1], input.bounds)},
                settings_, rect.Expand(settings_.pass_reach_px() + 1));
  const ColorHalves color = input.color;
  Probe(settings_.probe_step, &input);
  const ColorHalves* const colors[] = {&color, &input.color};
  *news = Keep(RunPilotPasses(input, colors, features, pilot, 1, {frame_, rect, settings_}),
               &second_);
}

FilteredPlanes RegressionFrame::Finish(const FramePlanes& planes, const PixelRect& window) const {
  const PixelRect read = window.Expand(settings_.picture_reach_px());
  std::array<Candidates, kNumRuns> candidates;
  for (size_t run = 0; run < kNumRuns; ++run) {
    candidates[run] = {Part(first_.runs[run], read), Part(second_.runs[run], read)};
  }
  return BlendAndJudge(planes, frame_, candidates[0], candidates[1], window, settings_);
}

}  // namespace tessera
