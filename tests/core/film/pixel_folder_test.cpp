#include "core/film/pixel_folder.h"

#include <gtest/gtest.h>

#include <utility>
#include <vector>

#include "tests/core/film/sample_streams.h"

namespace tessera {
namespace {

constexpr PixelRect kPixel{0, 0, 1, 1};

TEST(PixelFolderTest, AFolderForgetsItsLastPixel) {
  PixelFolder used;
  const struct {
    SampleRange range;
    int64_t feature_end;
  } kNodes[] = {{{0, 16}, kAllFeatures},
                {{5, 6}, 4},
                {{4, 5}, kAllFeatures},
                {{8, 10}, 4},
                {{0, 4}, kAllFeatures},
                {{0, 16}, 2},
                {{0, 2}, 1},
                {{0, 1}, 1},
                {{1, 2}, 1},
                {{16, 32}, 8},
                {{0, 8}, 8}};
  for (const auto& [range, feature_end] : kNodes) {
    TileStatistics from_used(kPixel, range, feature_end), from_fresh(kPixel, range, feature_end);
    used.Begin(0, 0, range, feature_end);
    PixelFolder once;
    once.Begin(0, 0, range, feature_end);
    for (int64_t i = range.begin; i < range.end; ++i) {
      used.Add(SampleOf(1, 0, 0, i));
      once.Add(SampleOf(1, 0, 0, i));
    }
    used.Store(&from_used);
    once.Store(&from_fresh);
    EXPECT_EQ(from_used, from_fresh) << range.begin;
  }
}

// Long runs of sky are folded by a shorter way; joined one by one they have the same bits.
TEST(PixelFolderTest, SkyFoldsLikeAnythingElse) {
  PixelFolder folder;
  for (uint64_t seed = 0; seed < 40; ++seed) {
    for (int64_t feature_end : {kAllFeatures, int64_t{8}}) {
      const auto sample_of = [&](int64_t i) {
        PixelSample sample = SampleOf(seed, 0, 0, i);
        // Runs of 4 with and without features.
        if (HashOf(seed + static_cast<uint64_t>(i / 4) * 77) % 4 != 0) {
          const PixelSample all = sample;
          sample = PixelSample{};
          for (int c = 0; c < 3; ++c) sample.radiance[c] = all.radiance[c];
        }
        return sample;
      };
      TileStatistics whole(kPixel, {0, 64}, feature_end);
      folder.Begin(0, 0, whole.range(), feature_end);
      for (int64_t i = 0; i < 64; ++i) folder.Add(sample_of(i));
      folder.Store(&whole);
      std::vector<TileStatistics> parts;
      for (int64_t i = 0; i < 64; ++i) {
        TileStatistics part(kPixel, {i, i + 1}, feature_end);
        PixelFolder one;
        one.Begin(0, 0, part.range(), feature_end);
        one.Add(sample_of(i));
        one.Store(&part);
        parts.push_back(std::move(part));
        for (int64_t n = i + 1; n % 2 == 0; n /= 2) {
          TileStatistics right = std::move(parts.back());
          parts.pop_back();
          parts.back().Merge(right);
        }
      }
      ASSERT_EQ(parts.size(), 1u);
      EXPECT_EQ(whole, parts[0]) << seed;
    }
  }
}

TEST(PixelFolderTest, HalvesTakeEvenAndOddSamples) {
  PixelFolder folder;
  TileStatistics tile(kPixel, {4, 8});
  folder.Begin(0, 0, tile.range());
  for (int64_t i = 4; i < 8; ++i) {
    PixelSample sample;
    sample.radiance[0] = static_cast<float>(i);
    folder.Add(sample);
  }
  folder.Store(&tile);
  EXPECT_EQ(tile.Floats(0, kRadianceMean)[0], 5);
  EXPECT_EQ(tile.Floats(1, kRadianceMean)[0], 6);
  EXPECT_EQ(tile.Floats(0, kRadianceMsd)[0], 1);
}

TEST(PixelFolderTest, DepthAveragesOverHitsAndMissesVoteForNone) {
  PixelFolder folder;
  TileStatistics tile(kPixel, {0, 8});
  folder.Begin(0, 0, tile.range());
  for (int i = 0; i < 8; ++i) {
    PixelSample sample;
    if (i == 2) {
      sample.depth = 10;
      sample.albedo[0] = 1;
      sample.material_id = 9;
    }
    folder.Add(sample);
  }
  folder.Store(&tile);
  EXPECT_EQ(tile.Counts(0, kHits)[0], 1u);
  EXPECT_EQ(tile.Counts(1, kHits)[0], 0u);
  EXPECT_EQ(tile.Floats(0, kDepthMean)[0], 10);
  EXPECT_EQ(tile.Floats(0, kDepthMsd)[0], 0);
  EXPECT_EQ(tile.Floats(1, kDepthMean)[0], 0);
  EXPECT_EQ(tile.Floats(0, kAlbedoMean)[0], 0.25f);
  EXPECT_EQ(tile.Counts(0, kMaterialId)[0], 0u);
  EXPECT_EQ(tile.Counts(0, kIdVotes)[0], 2u);
}

TEST(PixelFolderDeathTest, RefusesWhatIsNoNodeAndWhatIsNotComplete) {
  PixelFolder folder;
  EXPECT_DEATH(folder.Begin(0, 0, {1, 3}), "broken invariant");
  TileStatistics tile(kPixel, {0, 4});
  folder.Begin(0, 0, tile.range());
  folder.Add(PixelSample{});
  EXPECT_DEATH(folder.Store(&tile), "broken invariant");
}

}  // namespace
}  // namespace tessera
