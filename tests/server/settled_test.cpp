// Previews leave alone what cannot have changed visibly, and nothing else.
#include "server/picture/settled.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <numeric>
#include <random>

#include "core/image/display_transform.h"
#include "core/image/layers.h"
#include "server/coordinator/job_settings.h"
#include "server/picture/picture.h"
#include "tests/server/simulated_farm.h"

namespace tessera {
namespace {

constexpr int kTilePx = 16;
constexpr int64_t kQuiet = 0, kNoisy = 3;  // tiles of the pictures below, no neighbours

v1::JobSettings Settings() {
  v1::JobSettings settings = SmallSettings();
  settings.set_width(8 * kTilePx);
  settings.set_height(kTilePx);
  settings.set_tile_size(kTilePx);
  settings.set_denoiser("regression");
  return settings;
}

// Columns of pixels left of `noisy_from` have `quiet` in every sample.
TileStatistics TileOf(const PixelRect& window, int64_t spp, int noisy_from, float quiet) {
  TileStatistics tile(window, SampleRange{0, spp});
  PixelFolder folder;
  for (int y = window.y_begin; y < window.y_end; ++y) {
    for (int x = window.x_begin; x < window.x_end; ++x) {
      folder.Begin(x, y, tile.range(), kAllFeatures);
      for (int64_t i = 0; i < spp; ++i) {
        const uint64_t bits =
            MixBits(MixBits(static_cast<uint64_t>(y * 4096 + x)) + static_cast<uint64_t>(i));
        PixelSample sample;
        const float noise = static_cast<float>(bits & 1023) / 512.0f;
        std::ranges::fill(sample.radiance, x < noisy_from ? quiet : noise);
        folder.Add(sample);
      }
      folder.Store(&tile);
    }
  }
  return tile;
}

Picture::TileSource Source(const v1::JobSettings& settings, int64_t spp, int noisy_from,
                           float quiet) {
  return [grid = TileGrid(RegionOf(settings), kTilePx), spp, noisy_from, quiet](int64_t tile) {
    return TileOf(grid.WindowOf(tile), spp, noisy_from, quiet);
  };
}

const std::vector<int64_t> kAll = {0, 1, 2, 3, 4, 5, 6, 7};

Image Shown(const Picture& picture, const PixelRect& region, const char* layer = "final") {
  return *picture.Snapshot(region, {layer});
}

bool SameBits(const Image& a, const Image& b) {
  for (size_t c = 0; c < a.channels.size(); ++c) {
    const std::vector<float>&x = a.channels[c].floats, &y = b.channels[c].floats;
    if (x.size() != y.size() || std::memcmp(x.data(), y.data(), 4 * x.size()) != 0) return false;
  }
  return true;
}

// A frame of one pixel, shown as `shown`, with samples of mean and variance of the mean.
bool IsSettledPixel(float shown, float mean, float variance, float error = 0.01f) {
  const PixelRect pixel = PixelRect::FromSize(0, 0, 1, 1);
  FramePlanes planes(pixel);
  FilteredPlanes filtered(pixel);
  for (size_t c = 0; c < 3; ++c) {
    planes.color[c][0] = mean;
    planes.variance[c][0] = variance;
    filtered.color[c][0] = shown;
    filtered.error[c][0] = error;
  }
  return IsSettled(planes, filtered, pixel);
}

TEST(IsSettled, TakesWhatIsKnownAndNothingElse) {
  const float unknown = std::numeric_limits<float>::infinity();
  EXPECT_TRUE(IsSettledPixel(0.5f, 0.5f, 0));
  EXPECT_TRUE(IsSettledPixel(0, 0, 0));
  EXPECT_TRUE(IsSettledPixel(0.5f, 0.501f, 0));
  EXPECT_FALSE(IsSettledPixel(0.5f, 0.51f, 0));
  EXPECT_FALSE(IsSettledPixel(0, 1e-6f, 0));
  EXPECT_FALSE(IsSettledPixel(0, 1, 1));  // the first light in a dark pixel
  EXPECT_FALSE(IsSettledPixel(0.5f, 0.5f, 1e-4f));
  EXPECT_FALSE(IsSettledPixel(0.5f, 0.5f, unknown));
  EXPECT_FALSE(IsSettledPixel(0.5f, 0.5f, 0, unknown));
  EXPECT_FALSE(IsSettledPixel(std::numeric_limits<float>::quiet_NaN(), 0.5f, 0));
}

TEST(IsSettled, NoExposureShowsMoreThanHalfAStep) {
  std::mt19937 random(1);
  std::uniform_real_distribution<float> stops(-12, 12), relative(-0.006f, 0.006f),
      deviation(0, 0.003f);
  int num_settled = 0;
  for (int i = 0; i < 20000; ++i) {
    const float shown = std::exp2(stops(random));
    const float mean = shown * (1 + relative(random));
    const float sd = shown * deviation(random);
    if (!IsSettledPixel(shown, mean, sd * sd)) continue;
    ++num_settled;
    const float exposure = std::exp2(stops(random));
    for (const float end : {mean - 1.96f * sd, mean + 1.96f * sd}) {
      EXPECT_LE(std::abs(SrgbEncode(exposure * end) - SrgbEncode(exposure * shown)), 0.502f / 255);
    }
  }
  EXPECT_GT(num_settled, 1000);
  EXPECT_LT(num_settled, 15000);
}

TEST(Settled, QuietTilesAreSparedNoisyOnesAreNot) {
  const v1::JobSettings settings = Settings();
  const int noisy_from = 3 * kTilePx;
  Picture picture(settings);
  picture.Update(kAll, Source(settings, 4, noisy_from, 0.7f), DenoiseQuality::kPreview, 1);
  EXPECT_EQ(picture.num_spared(), 0);  // nothing was shown
  const TileGrid grid(RegionOf(settings), kTilePx);
  const Image noisy = Shown(picture, grid.WindowOf(kNoisy));
  picture.Update(kAll, Source(settings, 16, noisy_from, 0.7f), DenoiseQuality::kPreview, 1);
  EXPECT_GE(picture.num_spared(), 1);
  EXPECT_LE(picture.num_spared(), 3);
  EXPECT_FALSE(SameBits(noisy, Shown(picture, grid.WindowOf(kNoisy))));
  EXPECT_FALSE(picture.is_refined());
}

TEST(Settled, TheLastPictureHasTheBitsOfAFreshOne) {
  for (const std::string& denoiser : DenoiserNames()) {
    for (const v1::Quality quality : {v1::QUALITY_FINAL, v1::QUALITY_PREVIEW}) {
      SCOPED_TRACE(denoiser);
      v1::JobSettings settings = Settings();
      settings.set_denoiser(denoiser);
      settings.set_quality(quality);
      const int noisy_from = 4 * kTilePx;
      Picture grown(settings), fresh(settings);
      for (const int64_t spp : {2, 4, 8, 16}) {
        grown.Update(kAll, Source(settings, spp, noisy_from, 0.7f), DenoiseQuality::kPreview, 1);
      }
      EXPECT_GT(grown.num_spared(), 0);
      EXPECT_FALSE(grown.is_refined());
      grown.Update({}, Source(settings, 16, noisy_from, 0.7f), DenoiseQuality::kFinal, 1);
      fresh.Update(kAll, Source(settings, 16, noisy_from, 0.7f), DenoiseQuality::kFinal, 1);
      EXPECT_TRUE(grown.is_refined());
      for (const PictureLayer& layer : PictureLayers()) {
        EXPECT_TRUE(SameBits(Shown(grown, grown.region(), std::string(layer.name).c_str()),
                             Shown(fresh, grown.region(), std::string(layer.name).c_str())))
            << layer.name;
      }
    }
  }
}

// What previews show with and without sparing, as bytes of a PNG, at several exposures.
TEST(Settled, PreviewsDifferByAStepAtMost) {
  const v1::JobSettings settings = Settings();
  const int noisy_from = 3 * kTilePx;
  Picture sparing(settings), filtering(settings, false);
  for (const int64_t spp : {2, 4, 8, 64}) {
    for (Picture* const picture : {&sparing, &filtering}) {
      picture->Update(kAll, Source(settings, spp, noisy_from, 0.7f), DenoiseQuality::kPreview, 1);
    }
    const Image a = Shown(sparing, sparing.region()), b = Shown(filtering, sparing.region());
    for (size_t i = 0; i < a.channels[0].floats.size(); ++i) {
      for (const float exposure : {0.1f, 1.0f, 1.4f}) {
        const auto byte = [&](const Image& image) {
          return std::lround(255 * SrgbEncode(exposure * image.channels[0].floats[i]));
        };
        EXPECT_LE(std::abs(byte(a) - byte(b)), 1);
      }
    }
  }
  EXPECT_GT(sparing.num_spared(), 0);
  EXPECT_EQ(filtering.num_spared(), 0);
}

TEST(Settled, LightThatNoSampleHadFoundIsShown) {
  const v1::JobSettings settings = Settings();
  Picture picture(settings);
  const TileGrid grid(RegionOf(settings), kTilePx);
  picture.Update(kAll, Source(settings, 4, 8 * kTilePx, 0), DenoiseQuality::kPreview, 1);
  picture.Update(kAll, Source(settings, 8, 8 * kTilePx, 0), DenoiseQuality::kPreview, 1);
  EXPECT_EQ(picture.num_spared(), 8);
  picture.Update({kQuiet}, Source(settings, 16, 0, 0), DenoiseQuality::kPreview, 1);
  const Image shown = Shown(picture, grid.WindowOf(kQuiet));
  EXPECT_GT(*std::ranges::max_element(shown.channels[0].floats), 0.1f);
}

}  // namespace
}  // namespace tessera
