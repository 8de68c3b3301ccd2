// Every filter, kept up to date tile by tile, gives the bits that it gives from scratch.
#include "core/denoise/frame_filter.h"

#include <cstring>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "core/base/tile_grid.h"
#include "core/denoise/denoise_frame.h"
#include "gtest/gtest.h"
#include "tests/core/denoise/synthetic_frame.h"

namespace tessera {
namespace {

void OneByOne(size_t count, const std::function<void(size_t)>& body) {
  for (size_t i = count; i-- > 0;) body(i);
}

bool SameBits(const FilteredPlanes& a, const FilteredPlanes& b) {
  const auto same = [](const Plane& x, const Plane& y) {
    return x.size() == y.size() && std::memcmp(x.data(), y.data(), x.size() * sizeof(float)) == 0;
  };
  for (size_t c = 0; c < 3; ++c) {
    if (!same(a.color[c], b.color[c]) || !same(a.error[c], b.error[c])) return false;
  }
  return same(a.relative_error, b.relative_error) && same(a.relative_noise, b.relative_noise);
}

// Overwrites all but the calibrated variance of `rect`.
void CopyNews(const FramePlanes& from, const PixelRect& rect, FramePlanes* to) {
  const auto copy = [&](const auto& source, auto* target) {
    for (int y = rect.y_begin; y < rect.y_end; ++y) {
      std::copy_n(source.begin() + from.bounds.IndexOf(rect.x_begin, y), rect.width(),
                  target->begin() + from.bounds.IndexOf(rect.x_begin, y));
    }
  };
  for (size_t c = 0; c < 3; ++c) {
    copy(from.color[c], &to->color[c]);
    for (size_t half = 0; half < kNumHalves; ++half) {
      copy(from.color_half[half][c], &to->color_half[half][c]);
    }
    copy(from.sample_variance_of_mean[c], &to->sample_variance_of_mean[c]);
    copy(from.albedo[c], &to->albedo[c]);
    copy(from.normal[c], &to->normal[c]);
    copy(from.albedo_variance[c], &to->albedo_variance[c]);
  }
  copy(from.depth, &to->depth);
  copy(from.samples, &to->samples);
}

class EveryFrameFilter : public ::testing::TestWithParam<std::string> {};

INSTANTIATE_TEST_SUITE_P(Filters, EveryFrameFilter, ::testing::ValuesIn(DenoiserNames()),
                         [](const auto& filter) { return filter.param; });

// The frame is wider than the news' reach on both sides of most tiles. Some tiles have no samples
// at first; features and noise change with the news.
TEST_P(EveryFrameFilter, UpdatesEqualFromScratch) {
  const PixelRect bounds{-3, 9, 237, 149};
  const auto denoiser = *MakeDenoiser(GetParam());
  SyntheticFrame now = MakeSyntheticFrame(bounds, 0.3f, 4, 1);
  for (int y = 30; y < 70; ++y) {
    for (int x = 20; x < 60; ++x) {
      const auto i = static_cast<size_t>(bounds.IndexOf(x, y));
      now.planes.samples[i] = 0;
      for (size_t c = 0; c < 3; ++c) {
        now.planes.color[c][i] = 0;
        now.planes.color_half[0][c][i] = now.planes.color_half[1][c][i] = 0;
      }
    }
  }
  CalibrateVariance(bounds, &now.planes);
  const FrameParameters parameters{bounds, DenoiseQuality::kFinal};
  const std::unique_ptr<FrameFilter> filter = denoiser->MakeFrameFilter(parameters, bounds);
  FilteredPlanes picture(bounds);
  const auto put = [&](const FilteredPlanes& part) { CopyPixels(part, &picture); };
  const PixelRect whole[] = {bounds};
  filter->Filter(now.planes, whole, OneByOne, put);
  const TileGrid grid(bounds, 16);
  std::mt19937 random(2);
  std::vector<PixelRect> stale;
  for (uint32_t round = 0; round < 4; ++round) {
    SyntheticFrame later = MakeSyntheticFrame(bounds, 0.2f, 8, 10 + round);
    for (float& value : later.planes.albedo[0]) value += 0.01f * static_cast<float>(round);
    for (uint32_t tile = 0; tile <= round % 3; ++tile) {
      const PixelRect news = grid.WindowOf(static_cast<int64_t>(
          random() % static_cast<uint32_t>(grid.num_tiles())));
      CopyNews(later.planes, news, &now.planes);
      filter->Invalidate(news);
      stale.push_back(news.Expand(filter->reach_px()).Intersect(bounds));
    }
    CalibrateVariance(bounds, &now.planes);
    if (round == 1) continue;  // two rounds of news at once
    for (const PixelRect& window : stale) filter->Filter(now.planes, {&window, 1}, OneByOne, put);
    stale.clear();
    const FilteredPlanes fresh = DenoiseFrame(*denoiser, now.planes, DenoiseQuality::kFinal, 2);
    ASSERT_TRUE(SameBits(picture, fresh)) << round;
  }
}

TEST(FrameFilter, WindowFiltersKeepNothing) {
  const auto denoiser = *MakeDenoiser("bilateral");
  const PixelRect bounds{0, 0, 40, 30};
  const auto filter = denoiser->MakeFrameFilter({bounds, DenoiseQuality::kFinal}, bounds);
  EXPECT_EQ(filter->kept_bytes(), 0);
  EXPECT_EQ(filter->reach_px(),
            denoiser->halo_px(DenoiseQuality::kFinal) + kCalibrationRadiusPx);
}

}  // namespace
}  // namespace tessera
