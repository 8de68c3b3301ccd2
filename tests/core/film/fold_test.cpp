// Contract C1's accuracy: folded statistics against two passes in long double over the same
// samples.
#include "core/film/fold.h"

#include <gtest/gtest.h>

#include <functional>
#include <limits>
#include <string>
#include <vector>

#include "core/film/frame_planes.h"
#include "tests/core/film/sample_streams.h"

namespace tessera {
namespace {

constexpr PixelRect kPixel{0, 0, 1, 1};

// Samples [0, values.size()) of one pixel whose red is values[i], folded along the tree.
TileStatistics FoldStream(const std::vector<float>& values) {
  TileStatistics folded(kPixel, {0, 0});
  PixelFolder folder;
  for (const SampleRange node : MaximalNodes({0, static_cast<int64_t>(values.size())})) {
    TileStatistics tile(kPixel, node);
    folder.Begin(0, 0, node);
    for (int64_t i = node.begin; i < node.end; ++i) {
      PixelSample sample;
      sample.radiance[0] = values[static_cast<size_t>(i)];
      folder.Add(sample);
    }
    folder.Store(&tile);
    folded.Merge(tile);
  }
  return folded;
}

std::vector<float> HalfOf(const std::vector<float>& values, int half) {
  std::vector<float> half_values;
  for (size_t i = static_cast<size_t>(half); i < values.size(); i += 2) {
    half_values.push_back(values[i]);
  }
  return half_values;
}

enum class Expect { kAccurate, kMeanOnly, kFiniteOnly };

// From so many blocks of a half on contract C1's limits hold. Below, rounding (node_rounding.h) may
// take its share of the statistical error: of the mean's standard error, and of the msd's, relative
// sqrt(2 / n), by the noise of both halves together.
constexpr size_t kManyBlocks = 1000000;
constexpr long double kMeanShare = 1 / 8.0L;
constexpr long double kMsdShare = 1;

void CheckStream(const std::string& name, const std::vector<float>& values, Expect expect) {
  SCOPED_TRACE(name + ", " + std::to_string(values.size()) + " samples");
  const TileStatistics folded = FoldStream(values);
  for (int half = 0; half < kNumHalves; ++half) {
    const float mean = folded.Floats(half, kRadianceMean)[0];
    const float msd = folded.Floats(half, kRadianceMsd)[0];
    ASSERT_TRUE(std::isfinite(mean));
    ASSERT_TRUE(std::isfinite(msd));
    ASSERT_GE(msd, 0);
    const std::vector<float> half_values = HalfOf(values, half);
    const ReferenceMoments reference = TwoPass(half_values);
    const long double count = static_cast<long double>(half_values.size());
    const long double all_msd = half_values.size() < kManyBlocks ? TwoPass(values).msd : 0;
    if (expect == Expect::kFiniteOnly) continue;
    // Half the least denormal for each level of the tree is beyond what float32 can hold.
    const long double scale = std::fabs(reference.mean) + std::sqrt(reference.msd);
    EXPECT_NEAR(mean, reference.mean,
                1e-6L * scale + kMeanShare * std::sqrt(all_msd / count) + 32 * 0x1p-149L);
    if (expect == Expect::kMeanOnly) continue;
    EXPECT_NEAR(msd, reference.msd,
                1e-3L * reference.msd + kMsdShare * std::sqrt(2 / count) * all_msd);
  }
}

std::vector<float> Normal(uint64_t seed, size_t count, double mean, double sd) {
  std::vector<float> values(count);
  for (size_t i = 0; i < count; ++i) {
    const double radius = std::sqrt(-2 * std::log(1.0 - UniformOf(HashOf(seed) + 2 * i)));
    values[i] = static_cast<float>(
        mean + sd * radius * std::cos(6.283185307179586 * UniformOf(HashOf(seed) + 2 * i + 1)));
  }
  return values;
}

TEST(FoldTest, MeanOverSpreadUpToAThousandIsAccurate) {
  for (const double ratio : {0.0, 1.0, 10.0, 100.0, 1000.0}) {
    for (const size_t count : {2u, 3u, 17u, 64u, 1000u, 4096u, 65535u}) {
      for (uint64_t seed = 0; seed < 5; ++seed) {
        CheckStream("ratio " + std::to_string(ratio), Normal(seed, count, ratio * 0.3, 0.3),
                    Expect::kAccurate);
      }
    }
  }
}

TEST(FoldTest, AMillionBlocksAreAccurate) {
  for (const double ratio : {1.0, 1000.0}) {
    CheckStream("ratio " + std::to_string(ratio), Normal(7, 2000000, ratio, 1), Expect::kAccurate);
  }
}

TEST(FoldTest, ExtremeRatiosStayFiniteAndTheirMeansAccurate) {
  for (const double ratio : {1e4, 1e5, 1e6, 1e7, 1e8}) {
    for (const size_t count : {16u, 999u, 16384u}) {
      CheckStream("ratio " + std::to_string(ratio), Normal(3, count, ratio, 1), Expect::kMeanOnly);
    }
  }
}

TEST(FoldTest, OneOutlierAnywhere) {
  for (const float outlier : {1e4f, 1e8f, 0x1p60f, -0x1p60f}) {
    for (const size_t count : {8u, 1000u, 4096u}) {
      for (const size_t at : {size_t{0}, count / 2, count - 1}) {
        std::vector<float> values = Normal(5, count, 1, 1);
        values[at] = outlier;
        CheckStream("outlier " + std::to_string(outlier) + " at " + std::to_string(at), values,
                    Expect::kAccurate);
      }
    }
  }
}

TEST(FoldTest, TheLargestSamplesOfBothSignsStayFinite) {
  std::vector<float> values(4096);
  for (size_t i = 0; i < values.size(); ++i) values[i] = (i / 2) % 2 == 0 ? 0x1p60f : -0x1p60f;
  CheckStream("alternating 2^60", values, Expect::kAccurate);
}

TEST(FoldTest, ConstantStreamsHaveNoSpread) {
  for (const float value : {0.0f, 1.0f, 0.1f, 1.0f / 3, 1e-38f, 1e-45f, 123456.789f, 0x1p60f}) {
    for (const size_t count : {1u, 2u, 3u, 7u, 64u, 1001u}) {
      const TileStatistics folded = FoldStream(std::vector<float>(count, value));
      for (int half = 0; half < kNumHalves; ++half) {
        if (folded.HalfCount(half) == 0) continue;
        EXPECT_EQ(folded.Floats(half, kRadianceMean)[0], value) << count;
        EXPECT_EQ(folded.Floats(half, kRadianceMsd)[0], 0) << count;
      }
    }
  }
}

TEST(FoldTest, DenormalsStayFinite) {
  std::vector<float> values = Normal(9, 1000, 0, 1e-40);
  CheckStream("denormals", values, Expect::kMeanOnly);
  for (float& value : values) value = std::fabs(value);
  CheckStream("positive denormals", values, Expect::kMeanOnly);
}

TEST(FoldTest, AlternatingSigns) {
  for (const float magnitude : {1e-3f, 1.0f, 1e6f}) {
    std::vector<float> values(5000);
    for (size_t i = 0; i < values.size(); ++i) {
      values[i] = ((i / 2) % 2 == 0 ? 1 : -1) * magnitude * (1 + UniformOf(i));
    }
    CheckStream("alternating", values, Expect::kAccurate);
  }
}

TEST(FoldTest, RareBrightSamples) {
  std::vector<float> values(100000);
  for (size_t i = 0; i < values.size(); ++i) values[i] = UniformOf(i) < 1e-3f ? 50.0f : 0.0f;
  CheckStream("one in a thousand", values, Expect::kAccurate);
}

// 2^30 samples cannot be drawn here; their statistics can be stated.
TEST(FoldTest, ABillionSamplesAndOne) {
  constexpr int64_t kMany = int64_t{1} << 30;
  TileStatistics many(kPixel, {0, kMany});
  for (int half = 0; half < kNumHalves; ++half) {
    many.MutableFloats(half, kRadianceMean)[0] = 2;
    many.MutableFloats(half, kRadianceMsd)[0] = 0.25f;
  }
  for (const float value : {2.0f, 3.0f, 1e4f, 0x1p60f}) {
    TileStatistics one(kPixel, {kMany, kMany + 1});
    one.MutableFloats(0, kRadianceMean)[0] = value;
    TileStatistics folded = many;
    folded.Merge(one);
    const long double count = static_cast<long double>(folded.HalfCount(0));
    const long double difference = static_cast<long double>(value) - 2;
    const long double msd =
        0.25L * ((count - 1) / count) + difference * difference * ((count - 1) / count) / count;
    EXPECT_NEAR(folded.Floats(0, kRadianceMean)[0], 2 + difference / count,
                1e-6L * (2 + difference / count + std::sqrt(msd)));
    EXPECT_NEAR(folded.Floats(0, kRadianceMsd)[0], msd, 1e-3L * msd);
    EXPECT_EQ(folded.Floats(1, kRadianceMean)[0], 2);
    EXPECT_EQ(folded.Floats(1, kRadianceMsd)[0], 0.25f);
  }
}

TEST(FoldTest, OneSampleLeavesHalfBEmpty) {
  const TileStatistics folded = FoldStream({5});
  EXPECT_EQ(folded.HalfCount(1), 0);
  EXPECT_EQ(folded.Floats(0, kRadianceMean)[0], 5);
  EXPECT_EQ(folded.Floats(1, kRadianceMean)[0], 0);
}

TEST(FoldTest, ReplacedSamplesCountAsBlack) {
  std::vector<float> values = Normal(4, 1000, 5, 1);
  for (size_t i = 0; i < values.size(); i += 100) {
    PixelSample sample;
    sample.radiance[0] = i % 200 == 0 ? std::numeric_limits<float>::infinity() : std::nanf("");
    ASSERT_TRUE(ReplaceNonFinite(&sample));
    values[i] = sample.radiance[0];
  }
  CheckStream("with replaced samples", values, Expect::kAccurate);
}

TEST(FoldTest, RoundingIsToNearestAndTiesToEven) {
  EXPECT_EQ(RoundToBits<2>(1.0f), 1.0f);
  EXPECT_EQ(RoundToBits<2>(1.25f), 1.0f);
  EXPECT_EQ(RoundToBits<2>(1.75f), 2.0f);
  EXPECT_EQ(RoundToBits<2>(1.26f), 1.5f);
  EXPECT_EQ(RoundToBits<2>(-1.75f), -2.0f);
  EXPECT_EQ(RoundToBits<24>(0.1f), 0.1f);
  for (int i = 0; i < 1000; ++i) {
    const float value = std::exp2(80 * UniformOf(i) - 40);
    const float rounded = RoundToBits<kMsdBits>(value);
    EXPECT_LE(std::fabs(rounded - value), std::ldexp(value, -kMsdBits));
    EXPECT_EQ(RoundToBits<kMsdBits>(rounded), rounded);
  }
}

TEST(FoldTest, VotesKeepAMajorityInAnyTree) {
  for (uint64_t seed = 0; seed < 200; ++seed) {
    // Id 2 has more than half of 64 votes; fold random neighbours until one is left.
    std::vector<IdVote> votes;
    for (uint64_t i = 0; i < 64; ++i) {
      votes.push_back({i < 33 ? 2 : 3 + static_cast<uint32_t>(HashOf(seed * 64 + i) % 5), 1});
    }
    for (size_t i = 63; i > 0; --i) std::swap(votes[i], votes[HashOf(seed * 99 + i) % (i + 1)]);
    while (votes.size() > 1) {
      const size_t at = HashOf(seed * 77 + votes.size()) % (votes.size() - 1);
      votes[at] = FoldVotes(votes[at], votes[at + 1]);
      votes.erase(votes.begin() + static_cast<std::ptrdiff_t>(at) + 1);
    }
    EXPECT_EQ(votes[0].id, 2u);
    EXPECT_GE(votes[0].votes, 1u);
  }
}

TEST(FoldTest, TiedVotesGoToTheLowerId) {
  EXPECT_EQ(FoldVotes({5, 2}, {3, 2}).id, 3u);
  EXPECT_EQ(FoldVotes({3, 2}, {5, 2}).id, 3u);
  EXPECT_EQ(FoldVotes({0, 2}, {5, 2}).id, 0u);
  EXPECT_EQ(FoldVotes({5, 2}, {3, 2}).votes, 0u);
  EXPECT_EQ(FoldVotes({5, 3}, {3, 2}).votes, 1u);
  EXPECT_EQ(FoldVotes({5, 3}, {5, 2}).votes, 5u);
}

}  // namespace
}  // namespace tessera
