#include "core/denoise/window_codec.h"

#include <cstring>
#include <limits>
#include <memory>
#include <random>
#include <string>

#include "core/base/tile_grid.h"
#include "core/denoise/denoise_frame.h"
#include "core/denoise/frame_filter.h"
#include "gtest/gtest.h"
#include "tests/core/denoise/synthetic_frame.h"

namespace tessera {
namespace {

const PixelRect kFrame{-3, 9, 237, 149};

FramePlanes NoisyPlanes() {
  FramePlanes planes = MakeSyntheticFrame(kFrame, 0.3f, 4, 1).planes;
  planes.variance[1][7] = std::numeric_limits<float>::infinity();
  planes.depth[8] = -0.0f;
  return planes;
}

bool SameWords(const Plane& a, const Plane& b) {
  return a.size() == b.size() && std::memcmp(a.data(), b.data(), a.size() * sizeof(float)) == 0;
}

class EveryFilter : public ::testing::TestWithParam<std::string> {};
INSTANTIATE_TEST_SUITE_P(Filters, EveryFilter, ::testing::ValuesIn(DenoiserNames()),
                         [](const auto& filter) { return filter.param; });

// What a worker does for the server: the window from its planes and halo alone, out and back as
// bytes, is the frame's own, bit for bit, at either quality, also at the frame's borders.
TEST_P(EveryFilter, WindowsFilteredElsewhereAreTheFramesOwn) {
  const auto denoiser = *MakeDenoiser(GetParam());
  const FramePlanes planes = NoisyPlanes();
  for (const DenoiseQuality quality : {DenoiseQuality::kPreview, DenoiseQuality::kFinal}) {
    const FilteredPlanes whole = DenoiseFrame(*denoiser, planes, quality, 1);
    FilteredPlanes joined(kFrame);
    const PixelRect frame[] = {kFrame};
    for (const PixelRect& window : SplitWindows(frame, 96)) {
      const PixelRect bounds = window.Expand(denoiser->halo_px(quality)).Intersect(kFrame);
      const auto there = DecodeFilterInput(bounds, EncodeFilterInput(planes, bounds));
      ASSERT_TRUE(there.ok()) << there.status();
      FilteredPlanes filtered(window);
      const auto one_by_one = [](size_t count, const std::function<void(size_t)>& body) {
        for (size_t i = 0; i < count; ++i) body(i);
      };
      denoiser->MakeFrameFilter({kFrame, quality}, bounds)
          ->Filter(*there, {&window, 1}, one_by_one,
                   [&](const FilteredPlanes& part) { CopyPixels(part, &filtered); });
      const auto back = DecodeFiltered(window, EncodeFiltered(filtered));
      ASSERT_TRUE(back.ok()) << back.status();
      CopyPixels(*back, &joined);
    }
    EXPECT_TRUE(SameBits(joined, whole));
  }
}

TEST(WindowCodec, PlanesComeBackBitForBit) {
  const FramePlanes planes = NoisyPlanes();
  const auto back = DecodeFilterInput(kFrame, EncodeFilterInput(planes, kFrame));
  ASSERT_TRUE(back.ok());
  EXPECT_EQ(back->bounds, kFrame);
  for (size_t c = 0; c < 3; ++c) {
    EXPECT_TRUE(SameWords(back->color[c], planes.color[c]));
    for (size_t half = 0; half < kNumHalves; ++half) {
      EXPECT_TRUE(SameWords(back->color_half[half][c], planes.color_half[half][c]));
    }
    EXPECT_TRUE(SameWords(back->sample_variance_of_mean[c], planes.sample_variance_of_mean[c]));
    EXPECT_TRUE(SameWords(back->variance[c], planes.variance[c]));
    EXPECT_TRUE(SameWords(back->albedo[c], planes.albedo[c]));
    EXPECT_TRUE(SameWords(back->albedo_variance[c], planes.albedo_variance[c]));
    EXPECT_TRUE(SameWords(back->normal[c], planes.normal[c]));
    EXPECT_TRUE(SameWords(back->normal_variance[c], planes.normal_variance[c]));
  }
  EXPECT_TRUE(SameWords(back->depth, planes.depth));
  EXPECT_TRUE(SameWords(back->depth_variance, planes.depth_variance));
  EXPECT_TRUE(SameWords(back->coverage, planes.coverage));
  EXPECT_EQ(back->material_id, planes.material_id);
  EXPECT_EQ(back->samples, planes.samples);
}

// Bytes from outside: refused, or some planes of the right size; never a crash.
TEST(WindowCodec, DamagedBytesDoNoHarm) {
  const PixelRect window{0, 0, 9, 7};
  FilteredPlanes planes(window);
  std::mt19937 random(5);
  for (float& value : planes.color[0]) value = static_cast<float>(random()) * 0x1p-32f;
  const std::string payload = EncodeFiltered(planes);
  EXPECT_FALSE(DecodeFiltered(window, "").ok());
  EXPECT_FALSE(DecodeFiltered(window, payload.substr(0, payload.size() / 2)).ok());
  EXPECT_FALSE(DecodeFiltered({0, 0, 9, 8}, payload).ok());
  EXPECT_FALSE(DecodeFiltered({0, 0, 0, 0}, payload).ok());
  for (int i = 0; i < 4000; ++i) {
    std::string damaged = payload;
    for (int k = 0; k < 1 + i % 4; ++k) {
      damaged[random() % damaged.size()] = static_cast<char>(random());
    }
    const auto back = DecodeFiltered(window, damaged);
    if (!back.ok()) continue;
    ASSERT_EQ(back->bounds, window);
    ASSERT_EQ(back->relative_noise.size(), 63u);
  }
}

TEST(WindowCodec, TheChecksumBindsThePayloadToItsKey) {
  const FilteredKey key{.lease_id = 7, .job = "jobs/1", .revision = 3, .window = {0, 0, 8, 8}};
  const uint64_t sum = FilteredChecksum(key, "payload");
  for (const FilteredKey& other :
       {FilteredKey{8, "jobs/1", 3, {0, 0, 8, 8}}, FilteredKey{7, "jobs/2", 3, {0, 0, 8, 8}},
        FilteredKey{7, "jobs/1", 4, {0, 0, 8, 8}}, FilteredKey{7, "jobs/1", 3, {0, 8, 8, 16}}}) {
    EXPECT_NE(FilteredChecksum(other, "payload"), sum);
  }
  EXPECT_NE(FilteredChecksum(key, "payloae"), sum);
}

}  // namespace
}  // namespace tessera
