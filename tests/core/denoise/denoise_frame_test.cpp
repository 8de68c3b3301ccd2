// A tile does not know that it is a tile: every filter gives the same bits for any windows and
// threads; and what all filters owe: no NaN, constants stay, unknown pixels are marked.
#include "core/denoise/denoise_frame.h"

#include <cmath>
#include <cstring>
#include <limits>
#include <memory>
#include <string>

#include "core/base/tile_grid.h"
#include "gtest/gtest.h"
#include "tests/core/denoise/synthetic_frame.h"

namespace tessera {
namespace {

class EveryFilter : public ::testing::TestWithParam<std::string> {
 protected:
  std::unique_ptr<Denoiser> denoiser_ = *MakeDenoiser(GetParam());
};

INSTANTIATE_TEST_SUITE_P(Filters, EveryFilter, ::testing::ValuesIn(DenoiserNames()),
                         [](const auto& filter) { return filter.param; });

bool SameBits(const Plane& a, const Plane& b) {
  return a.size() == b.size() && std::memcmp(a.data(), b.data(), a.size() * sizeof(float)) == 0;
}

void ExpectSameBits(const FilteredPlanes& a, const FilteredPlanes& b) {
  for (int c = 0; c < 3; ++c) {
    EXPECT_TRUE(SameBits(a.color[c], b.color[c]));
    EXPECT_TRUE(SameBits(a.error[c], b.error[c]));
  }
  EXPECT_TRUE(SameBits(a.relative_error, b.relative_error));
  EXPECT_TRUE(SameBits(a.relative_noise, b.relative_noise));
}

FramePlanes Crop(const FramePlanes& planes, const PixelRect& bounds) {
  FramePlanes cropped(bounds);
  const auto copy = [&](const auto& from, auto* to) {
    for (int y = bounds.y_begin; y < bounds.y_end; ++y) {
      for (int x = bounds.x_begin; x < bounds.x_end; ++x) {
        (*to)[bounds.IndexOf(x, y)] = from[planes.bounds.IndexOf(x, y)];
      }
    }
  };
  for (int c = 0; c < 3; ++c) {
    copy(planes.color[c], &cropped.color[c]);
    for (int half = 0; half < kNumHalves; ++half) {
      copy(planes.color_half[half][c], &cropped.color_half[half][c]);
    }
    copy(planes.sample_variance_of_mean[c], &cropped.sample_variance_of_mean[c]);
    copy(planes.variance[c], &cropped.variance[c]);
    copy(planes.albedo[c], &cropped.albedo[c]);
    copy(planes.albedo_variance[c], &cropped.albedo_variance[c]);
    copy(planes.normal[c], &cropped.normal[c]);
    copy(planes.normal_variance[c], &cropped.normal_variance[c]);
  }
  copy(planes.depth, &cropped.depth);
  copy(planes.depth_variance, &cropped.depth_variance);
  copy(planes.coverage, &cropped.coverage);
  copy(planes.material_id, &cropped.material_id);
  copy(planes.samples, &cropped.samples);
  return cropped;
}

// Some pixels have no samples, some one, some an odd number.
void MakePatchy(FramePlanes* planes) {
  for (int64_t i = 0; i < planes->bounds.area(); ++i) {
    if (i % 37 == 0) planes->samples[i] = 0;
    if (i % 41 == 0) planes->samples[i] = 1;
    if (i % 43 == 0) planes->samples[i] = 7;
  }
  CalibrateVariance(planes->bounds, planes);
}

TEST_P(EveryFilter, TilesEqualTheWholeFrame) {
  SyntheticFrame frame = MakeSyntheticFrame({3, -5, 56, 36}, 0.3f, 16, 1);
  MakePatchy(&frame.planes);
  for (const DenoiseQuality quality : {DenoiseQuality::kPreview, DenoiseQuality::kFinal}) {
    const FrameParameters parameters{frame.planes.bounds, quality};
    const FilteredPlanes whole = DenoiseFrame(*denoiser_, frame.planes, quality, 1);
    for (const int tile_size : {1, 7, 16, 32, 1000}) {
      const TileGrid grid(frame.planes.bounds, tile_size);
      FilteredPlanes tiled(frame.planes.bounds);
      // Single pixels cost a halo each: a line of them will do.
      const int64_t step = tile_size == 1 ? 29 : 1;
      if (tile_size == 1) tiled = whole;
      for (int64_t tile = 0; tile < grid.num_tiles(); tile += step) {
        const PixelRect window = grid.WindowOf(tile);
        const int halo_px = denoiser_->halo_px(quality);
        const PixelRect read = window.Expand(halo_px).Intersect(parameters.frame);
        denoiser_->Filter(Crop(frame.planes, read), parameters, window, &tiled);
      }
      SCOPED_TRACE(tile_size);
      ExpectSameBits(tiled, whole);
    }
  }
}

// A frame beyond the halo on every side, of which the filter gets the halo alone.
TEST_P(EveryFilter, TheHaloIsAllThatAWindowNeeds) {
  const SyntheticFrame frame = MakeSyntheticFrame({-7, 5, 170, 171}, 0.2f, 16, 3);
  const PixelRect window{75, 80, 92, 91};
  for (const DenoiseQuality quality : {DenoiseQuality::kPreview, DenoiseQuality::kFinal}) {
    const FrameParameters parameters{frame.planes.bounds, quality};
    const PixelRect read = window.Expand(denoiser_->halo_px(quality));
    ASSERT_TRUE(frame.planes.bounds.Contains(read));
    FilteredPlanes whole(window), cropped(window);
    denoiser_->Filter(frame.planes, parameters, window, &whole);
    denoiser_->Filter(Crop(frame.planes, read), parameters, window, &cropped);
    ExpectSameBits(cropped, whole);
  }
}

TEST_P(EveryFilter, ThreadsAndWindowsDoNotMatter) {
  const SyntheticFrame frame = MakeSyntheticFrame({0, 0, 67, 45}, 0.3f, 4, 2);
  const FilteredPlanes one = DenoiseFrame(*denoiser_, frame.planes, DenoiseQuality::kFinal, 1);
  const FilteredPlanes four = DenoiseFrame(*denoiser_, frame.planes, DenoiseQuality::kFinal, 4);
  ExpectSameBits(one, four);
  const TileGrid grid(frame.planes.bounds, 16);
  std::vector<PixelRect> windows;
  for (int64_t tile = grid.num_tiles() - 1; tile >= 0; --tile) {
    windows.push_back(grid.WindowOf(tile));
  }
  FilteredPlanes tiled(frame.planes.bounds);
  DenoiseWindows(*denoiser_, frame.planes, {frame.planes.bounds}, windows, 3, &tiled);
  ExpectSameBits(one, tiled);
}

TEST_P(EveryFilter, AConstantImageStaysConstant) {
  FramePlanes planes(PixelRect{0, 0, 31, 17});
  std::fill(planes.samples.begin(), planes.samples.end(), 8);
  for (int c = 0; c < 3; ++c) {
    for (Plane* plane : {&planes.color[c], &planes.color_half[0][c], &planes.color_half[1][c]}) {
      std::fill(plane->begin(), plane->end(), 0.37f);
    }
  }
  CalibrateVariance(planes.bounds, &planes);
  const FilteredPlanes out = DenoiseFrame(*denoiser_, planes, DenoiseQuality::kFinal, 1);
  for (int c = 0; c < 3; ++c) {
    for (const float value : out.color[c]) EXPECT_NEAR(value, 0.37f, 1e-6f);
    for (const float error : out.error[c]) EXPECT_LE(error, 2e-6f);
  }
}

// Each value that films may hold at the rim: none is NaN afterwards, errors are not negative.
TEST_P(EveryFilter, NothingBecomesNan) {
  const PixelRect bounds{0, 0, 21, 19};
  const float kHuge = 0x1p60f;
  const float kUnknown = std::numeric_limits<float>::infinity();
  for (const uint32_t samples : {0u, 1u, 2u, 3u, 1000000u}) {
    for (const float value : {0.0f, 1e-38f, 1.0f, kHuge}) {
      for (const bool spiky : {false, true}) {
        FramePlanes planes(bounds);
        for (int64_t i = 0; i < bounds.area(); ++i) {
          planes.samples[i] = samples;
          const bool lit = !spiky || i == bounds.area() / 2;
          for (int c = 0; c < 3; ++c) {
            planes.color_half[0][c][i] = samples > 0 && lit ? value : 0;
            planes.color_half[1][c][i] = samples > 1 && lit && !spiky ? value : 0;
            planes.color[c][i] =
                0.5f * planes.color_half[0][c][i] + 0.5f * planes.color_half[1][c][i];
            planes.albedo_variance[c][i] = samples < 2 ? kUnknown : 0;
            planes.normal_variance[c][i] = samples < 2 ? kUnknown : 0;
          }
          planes.depth_variance[i] = samples < 2 || i % 5 == 0 ? kUnknown : value;
          planes.depth[i] = i % 5 == 0 ? 0 : value;
        }
        CalibrateVariance(bounds, &planes);
        SCOPED_TRACE(testing::Message() << samples << " samples of " << value << " " << spiky);
        const FilteredPlanes out = DenoiseFrame(*denoiser_, planes, DenoiseQuality::kFinal, 1);
        int num_bad = 0;
        for (int c = 0; c < 3; ++c) {
          for (size_t i = 0; i < out.color[c].size(); ++i) {
            num_bad += !std::isfinite(out.color[c][i]) || out.color[c][i] < 0;
            num_bad += !(out.error[c][i] >= 0);
            if (samples < 2) num_bad += out.error[c][i] != kUnknown;
          }
        }
        for (size_t i = 0; i < out.relative_error.size(); ++i) {
          num_bad += std::isnan(out.relative_error[i]) || !(out.relative_noise[i] >= 0);
          if (samples < 2) num_bad += out.relative_error[i] != kUnknown;
        }
        EXPECT_EQ(num_bad, 0);
      }
    }
  }
}

TEST_P(EveryFilter, TilesWithoutSamplesAreMarkedAndLendNothing) {
  SyntheticFrame frame = MakeSyntheticFrame({0, 0, 48, 48}, 0.1f, 8, 3);
  FramePlanes& planes = frame.planes;
  const PixelRect hole{16, 16, 32, 32};
  for (int y = hole.y_begin; y < hole.y_end; ++y) {
    for (int x = hole.x_begin; x < hole.x_end; ++x) {
      const int64_t i = planes.bounds.IndexOf(x, y);
      planes.samples[i] = 0;
      for (int c = 0; c < 3; ++c) {
        planes.color[c][i] = planes.color_half[0][c][i] = planes.color_half[1][c][i] = 0;
        planes.variance[c][i] = std::numeric_limits<float>::infinity();
      }
    }
  }
  const FilteredPlanes out = DenoiseFrame(*denoiser_, planes, DenoiseQuality::kFinal, 1);
  int num_bad = 0;
  for (int y = 0; y < 48; ++y) {
    for (int x = 0; x < 48; ++x) {
      const int64_t i = planes.bounds.IndexOf(x, y);
      if (hole.Contains(x, y)) {
        num_bad += out.error[1][i] != std::numeric_limits<float>::infinity();
        num_bad += !std::isfinite(out.color[1][i]);
      } else {
        num_bad += !(out.color[1][i] > 0.25f * frame.truth[1][i] - 0.1f);
      }
    }
  }
  EXPECT_EQ(num_bad, 0);
}

TEST(DenoiseWindowsDeathTest, WindowsMustFit) {
  const FramePlanes planes(PixelRect{0, 0, 16, 16});
  FilteredPlanes out(planes.bounds);
  const PixelRect windows[] = {{0, 0, 8, 8}};
  const auto denoiser = *MakeDenoiser("bilateral");
  EXPECT_DEATH(DenoiseWindows(*denoiser, planes, {{0, 0, 100, 100}}, windows, 1, &out),
               "invariant");
}

}  // namespace
}  // namespace tessera
