#include "core/film/quantity_planes.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <set>
#include <span>
#include <vector>

#include "tests/core/film/sample_streams.h"

namespace tessera {
namespace {

constexpr PixelRect kWindow{0, 0, 8, 4};

TEST(QuantityPlanesTest, EveryPlaneBelongsToOneQuantityAndMeansFollowTheirMsds) {
  std::set<int> planes;
  int last_msd = -1;
  for (const Quantity& quantity : kQuantities) {
    for (int channel = 0; channel < quantity.num_channels; ++channel) {
      EXPECT_TRUE(planes.insert(quantity.first_plane + channel).second);
    }
    if (quantity.is_msd) last_msd = quantity.first_plane;
    if (quantity.is_mean) {
      EXPECT_EQ(last_msd, quantity.first_plane + quantity.num_channels);
    }
  }
  EXPECT_EQ(planes.size(), static_cast<size_t>(kNumPlanes));
}

TEST(QuantityPlanesTest, WordsAreACopyOfTheTileOrTheTileItself) {
  TileStatistics tile = FoldedTile(1, kWindow, {0, 16});
  QuantityPlanes copy, bound;
  copy.Resize(static_cast<size_t>(tile.num_pixels()));
  bound.Resize(static_cast<size_t>(tile.num_pixels()));
  for (const Quantity& quantity : kQuantities) {
    copy.Load(quantity, tile);
    for (int half = 0; half < kNumHalves; ++half) {
      for (int channel = 0; channel < quantity.num_channels; ++channel) {
        const int plane = quantity.first_plane + channel;
        bound.Overwrite(quantity, half, channel, &tile);
        const void* const own =
            plane < kFirstCountPlane
                ? static_cast<const void*>(tile.Floats(half, plane).data())
                : tile.Counts(half, plane - kFirstCountPlane).data();
        const std::span<const uint32_t> words = copy.words[half][channel];
        EXPECT_EQ(static_cast<const void*>(bound.words[half][channel].data()), own);
        EXPECT_EQ(bound.words[half][channel].size(), words.size());
        EXPECT_EQ(std::memcmp(words.data(), own, words.size_bytes()), 0);
      }
    }
  }
}

TEST(QuantityPlanesTest, PairsUnitsAreNoPlanesOfTheTile) {
  TileStatistics tile = FoldedTile(1, kWindow, {0, 2});
  QuantityPlanes planes;
  planes.Resize(static_cast<size_t>(tile.num_pixels()));
  planes.Overwrite(kQuantities[0], 0, 0, &tile);
  ASSERT_TRUE(HasPairUnits(kQuantities[0], tile));
  EXPECT_NE(static_cast<const void*>(planes.words[0][0].data()),
            static_cast<const void*>(tile.Floats(0, kRadianceMsd).data()));
}

// What the fold rounded means to is told from the msds, and of pairs written in their place: every
// mean's code is a small integer.
TEST(QuantityPlanesTest, MeansAreCodedInUnitsOfTheirRounding) {
  for (const SampleRange range : {SampleRange{0, 2}, SampleRange{64, 128}}) {
    const TileStatistics tile = FoldedTile(1, kWindow, range);
    QuantityPlanes planes;
    planes.Resize(static_cast<size_t>(tile.num_pixels()));
    planes.Load(kQuantities[0], tile);
    EXPECT_EQ(HasPairUnits(kQuantities[0], tile), range.size() == 2);
    if (range.size() == 2) planes.LoadPairUnits(kQuantities[0], tile);
    planes.KeepUnits(kQuantities[0], tile);
    planes.Load(kQuantities[1], tile);
    ASSERT_TRUE(kQuantities[1].is_mean);
    for (int half = 0; half < kNumHalves; ++half) {
      const PlaneContext context = planes.ContextOf(kQuantities[1], half, 0, tile);
      for (size_t i = 0; i < context.units.size(); ++i) {
        if (context.units[i] == 0) continue;
        const float unit = std::bit_cast<float>(context.units[i] << kFractionBits);
        EXPECT_EQ(std::fmod(tile.Floats(half, kRadianceMean)[i], unit), 0);
      }
      std::vector<uint32_t>& codes = planes.codes[half][0];
      const PlaneCoding coding =
          CodePlane(context, planes.words[half][0], kAbovePredictors, codes);
      EXPECT_TRUE(IsGrid(coding.predictor));
      std::ranges::sort(codes);
      EXPECT_LT(codes[codes.size() * 3 / 4], 1u << 12) << "24-bit means would take 20 bits";
      planes.Load(kQuantities[1], tile);
      CodePlane(context, planes.words[half][0], kAbovePredictors, codes);
      std::vector<uint32_t> restored(codes.size());
      RestorePlane(context, coding, codes, restored);
      EXPECT_TRUE(std::ranges::equal(restored, planes.words[half][0]));
    }
  }
}

// A film that begins at sample 0 is not rounded, and tells no units.
TEST(QuantityPlanesTest, WhatIsNotRoundedHasNoUnits) {
  const TileStatistics tile = FoldedTile(1, kWindow, {0, 64});
  QuantityPlanes planes;
  planes.Resize(static_cast<size_t>(tile.num_pixels()));
  planes.Load(kQuantities[0], tile);
  planes.KeepUnits(kQuantities[0], tile);
  EXPECT_TRUE(planes.ContextOf(kQuantities[1], 0, 0, tile).units.empty());
}

}  // namespace
}  // namespace tessera
