#include "core/film/fold_target.h"

#include <gtest/gtest.h>

#include "tests/core/film/sample_streams.h"

namespace tessera {
namespace {

constexpr int64_t kFeatureEnd = 4;
constexpr size_t kPlaneBytes = 8 * 8 * sizeof(float);
// All planes, but those that tiles share: no hits come later.
constexpr size_t kAllBytes =
    kNumHalves * (kNumFloatPlanes + int{kNumCountPlanes} - kNumLaterCountPlanes) * kPlaneBytes;
constexpr size_t kLaterBytes = kNumHalves * kNumRadiancePlanes * kPlaneBytes;
constexpr size_t kLaterHitsBytes = kNumHalves * kNumLaterCountPlanes * kPlaneBytes;

const TileGrid& Grid() {
  static const auto* const grid = new TileGrid(PixelRect::FromSize(0, 0, 16, 8), 8);
  return *grid;
}

Film FilmOf(int64_t tile, SampleRange range, int64_t feature_end) {
  Film film(Grid(), feature_end);
  EXPECT_TRUE(
      film.Accept(tile, FoldedTile(1, Grid().WindowOf(tile), range, feature_end)).ok());
  return film;
}

TEST(FoldTargetTest, IsTheNodeThatTheRangeJoins) {
  const Film film = FilmOf(1, {4, 8}, kAllFeatures);
  EXPECT_EQ(FoldTargetIn(film, 1, {8, 12}).num_bytes(), kAllBytes);
  EXPECT_EQ(FoldTargetIn(film, 1, {0, 4}).num_bytes(), kAllBytes);
  EXPECT_EQ(FoldTargetIn(film, 1, {12, 16}).num_bytes(), 0u);
  for (const int64_t tile : {int64_t{-1}, int64_t{0}, Grid().num_tiles()}) {
    EXPECT_EQ(FoldTargetIn(film, tile, {8, 12}).num_bytes(), 0u) << tile;
  }
}

TEST(FoldTargetTest, PlanesThatStayAreNotAskedFor) {
  const Film with = FilmOf(0, {0, 4}, kFeatureEnd), without = FilmOf(0, {4, 8}, kFeatureEnd);
  EXPECT_EQ(FoldTargetIn(with, 0, {4, 8}).num_bytes(), kLaterBytes);
  EXPECT_EQ(FoldTargetIn(without, 0, {0, 4}).num_bytes(), kLaterBytes + kLaterHitsBytes);
}

TEST(FoldTargetTest, IsAskedForUntilNothingIsLeft) {
  FoldTarget target;
  {
    const Film film = FilmOf(0, {0, 4}, kAllFeatures);
    target = FoldTargetIn(film, 0, {4, 8});
  }
  // The film is gone, and nobody reads it.
  target.PrefetchNext(100);
  EXPECT_EQ(target.num_bytes(), kAllBytes - 100);
  target.PrefetchNext(kAllBytes / 2);
  EXPECT_EQ(target.num_bytes(), kAllBytes / 2 - 100);
  target.PrefetchNext(kAllBytes);
  EXPECT_EQ(target.num_bytes(), 0u);
  target.PrefetchNext(1);
}

}  // namespace
}  // namespace tessera
