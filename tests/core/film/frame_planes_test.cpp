#include "core/film/frame_planes.h"

#include <gtest/gtest.h>

#include <limits>

#include "core/film/fold.h"
#include "tests/core/film/sample_streams.h"

namespace tessera {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();

TileStatistics FoldedPrefix(uint64_t seed, const PixelRect& window, int64_t num_samples,
                            int64_t feature_end = kAllFeatures) {
  TileStatistics folded(window, {0, 0}, feature_end);
  for (const SampleRange node : MaximalNodes({0, num_samples})) {
    folded.Merge(FoldedTile(seed, window, node, feature_end));
  }
  return folded;
}

TEST(FramePlanesTest, JoinsBothHalves) {
  const PixelRect bounds{0, 0, 10, 8}, window{3, 2, 7, 6};
  for (const int64_t num_samples : {int64_t{2}, int64_t{7}, int64_t{64}}) {
    FramePlanes planes(bounds);
    planes.Resolve(FoldedPrefix(4, window, num_samples));
    for (int y = window.y_begin; y < window.y_end; ++y) {
      for (int x = window.x_begin; x < window.x_end; ++x) {
        std::vector<float> red, albedo, normal, depth;
        for (int64_t i = 0; i < num_samples; ++i) {
          const PixelSample sample = SampleOf(4, x, y, i);
          red.push_back(sample.radiance[0]);
          albedo.push_back(sample.albedo[1]);
          normal.push_back(sample.normal[2]);
          if (sample.depth > 0) depth.push_back(sample.depth);
        }
        const size_t i = static_cast<size_t>(bounds.IndexOf(x, y));
        // Rounding takes small shares of a mean's error and of its variance.
        const auto expect_near = [](float mean, float variance, const std::vector<float>& values) {
          const long double divisor = static_cast<long double>(values.size()) - 1;
          const long double expected = TwoPass(values).mean;
          const long double expected_variance = TwoPass(values).msd / divisor;
          EXPECT_NEAR(mean, expected,
                      0.3L * std::sqrt(expected_variance) + 1e-6L * std::fabs(expected));
          EXPECT_NEAR(variance, expected_variance, 0.4L * expected_variance + 1e-7L);
        };
        expect_near(planes.color[0][i], planes.sample_variance_of_mean[0][i], red);
        expect_near(planes.albedo[1][i], planes.albedo_variance[1][i], albedo);
        expect_near(planes.normal[2][i], planes.normal_variance[2][i], normal);
        if (depth.size() >= 2) {
          expect_near(planes.depth[i], planes.depth_variance[i], depth);
        } else {
          EXPECT_EQ(planes.depth_variance[i], kInfinity);
        }
        EXPECT_NEAR(planes.coverage[i], static_cast<long double>(depth.size()) / num_samples, 1e-6);
        EXPECT_EQ(planes.samples[i], num_samples);
      }
    }
    EXPECT_EQ(planes.samples[0], 0u);
    EXPECT_EQ(planes.color[0][0], 0);
  }
}

TEST(FramePlanesTest, FeaturesHaveCountsOfTheirOwn) {
  const PixelRect window{0, 0, 5, 4};
  for (const int64_t feature_end : {1, 2, 8}) {
    FramePlanes all(window), first(window), planes(window);
    all.Resolve(FoldedPrefix(4, window, 19));
    first.Resolve(FoldedPrefix(4, window, feature_end));
    planes.Resolve(FoldedPrefix(4, window, 19, feature_end));
    EXPECT_EQ(planes.color, all.color);
    EXPECT_EQ(planes.sample_variance_of_mean, all.sample_variance_of_mean);
    EXPECT_EQ(planes.coverage, all.coverage);
    EXPECT_EQ(planes.samples, all.samples);
    EXPECT_EQ(planes.albedo, first.albedo);
    EXPECT_EQ(planes.albedo_variance, first.albedo_variance);
    EXPECT_EQ(planes.normal, first.normal);
    EXPECT_EQ(planes.normal_variance, first.normal_variance);
    EXPECT_EQ(planes.depth, first.depth);
    EXPECT_EQ(planes.depth_variance, first.depth_variance);
    EXPECT_EQ(planes.material_id, first.material_id);
  }
}

TEST(FramePlanesTest, OneSampleIsDefined) {
  const PixelRect window{0, 0, 3, 3};
  FramePlanes planes(window);
  planes.Resolve(FoldedTile(4, window, {0, 1}));
  for (size_t i = 0; i < 9; ++i) {
    const PixelSample sample = SampleOf(4, static_cast<int>(i) % 3, static_cast<int>(i) / 3, 0);
    EXPECT_EQ(planes.color[2][i], sample.radiance[2]);
    EXPECT_EQ(planes.color_half[0][2][i], sample.radiance[2]);
    EXPECT_EQ(planes.color_half[1][2][i], 0);
    EXPECT_EQ(planes.sample_variance_of_mean[2][i], kInfinity);
    EXPECT_EQ(planes.material_id[i], sample.material_id);
    EXPECT_EQ(planes.samples[i], 1u);
  }
}

TEST(FramePlanesTest, NoSamplesResolveToNothing) {
  const PixelRect window{0, 0, 2, 2};
  FramePlanes planes(window);
  planes.Resolve(FoldedTile(4, window, {0, 8}));
  planes.Resolve(TileStatistics(window, {0, 0}));
  for (size_t i = 0; i < 4; ++i) {
    EXPECT_EQ(planes.samples[i], 0u);
    EXPECT_EQ(planes.color[0][i], 0);
    EXPECT_EQ(planes.coverage[i], 0);
    EXPECT_EQ(planes.sample_variance_of_mean[0][i], kInfinity);
  }
}

TEST(FramePlanesTest, TheMajorityOfBothHalvesNamesTheMaterial) {
  TileStatistics tile({0, 0, 4, 1}, {0, 16});
  const struct {
    IdVote a, b;
    uint32_t expected;
  } kCases[] = {{{3, 8}, {3, 8}, 3}, {{3, 8}, {5, 2}, 3}, {{3, 1}, {5, 8}, 5}, {{7, 4}, {5, 4}, 5}};
  for (size_t i = 0; i < 4; ++i) {
    tile.MutableCounts(0, kMaterialId)[i] = kCases[i].a.id;
    tile.MutableCounts(0, kIdVotes)[i] = kCases[i].a.votes;
    tile.MutableCounts(1, kMaterialId)[i] = kCases[i].b.id;
    tile.MutableCounts(1, kIdVotes)[i] = kCases[i].b.votes;
  }
  FramePlanes planes(tile.window());
  planes.Resolve(tile);
  for (size_t i = 0; i < 4; ++i) EXPECT_EQ(planes.material_id[i], kCases[i].expected) << i;
}

}  // namespace
}  // namespace tessera
