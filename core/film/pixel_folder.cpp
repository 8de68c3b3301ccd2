#include "core/film/pixel_folder.h"

#include <algorithm>
#include <bit>

#include "core/base/check.h"
#include "core/denoise/float8.h"
#include "core/film/fold.h"
#include "core/film/node_rounding.h"

namespace tessera {
namespace {

// Lanes of a node: both halves' radiance in the two halves of a SIMD register, then a register of
// features (albedo, normal, depth) for each half.
constexpr int kDepthFeature = 6;
constexpr int kFeatureLane = kFloat8Lanes;
constexpr int kNumLanes = 3 * kFloat8Lanes;
constexpr int kNumLevels = 32;

constexpr int RadianceLane(int half) { return kFloat8Lanes / 2 * half; }
constexpr int FeatureLane(int half) { return kFeatureLane + kFloat8Lanes * half; }

// Both halves of one pixel over one node.
struct alignas(32) PixelNode {
  float mean[kNumLanes];
  float msd[kNumLanes];
  uint32_t later_hits[kNumHalves];
  uint32_t hits[kNumHalves];
  IdVote vote[kNumHalves];
  bool blank;  // all features are zero, the id too
};

// -0 becomes 0, which is the only zero that joins give.
float PlusZero(float x) { return x + 0.0f; }

void SetRadiance(const PixelSample& sample, int half, PixelNode* node) {
  float* mean = node->mean + RadianceLane(half);
  for (int c = 0; c < 3; ++c) mean[c] = PlusZero(sample.radiance[c]);
}

void SetFeatures(const PixelSample& sample, int half, PixelNode* node) {
  float* mean = node->mean + FeatureLane(half);
  for (int c = 0; c < 3; ++c) {
    mean[c] = PlusZero(sample.albedo[c]);
    mean[3 + c] = PlusZero(sample.normal[c]);
  }
  const bool hit = sample.depth > 0;
  mean[kDepthFeature] = hit ? sample.depth : 0;
  node->hits[half] = hit ? 1 : 0;
  node->vote[half] = {sample.material_id, 1};
}

bool IsBlank(const PixelNode& node) {
  uint32_t any = node.vote[0].id | node.vote[1].id | node.hits[0] | node.hits[1];
  for (int i = kFeatureLane; i < kNumLanes; ++i) any |= std::bit_cast<uint32_t>(node.mean[i]);
  return any == 0;
}

Float8 RoundMsd(Float8 msd) {
  constexpr uint32_t kDropped = 24 - kMsdBits;
  constexpr uint32_t kHalfBelow = (uint32_t{1} << (kDropped - 1)) - 1;
  using UInt8 = uint32_t __attribute__((vector_size(sizeof(Float8))));
  auto bits = reinterpret_cast<UInt8>(msd);
  bits += kHalfBelow + ((bits >> kDropped) & 1);
  return reinterpret_cast<Float8>(bits & ~((uint32_t{1} << kDropped) - 1));
}

// FoldMoments of eight lanes from `lane` on.
void FoldLanes(const PixelNode& left, const PixelNode& right, int lane, Float8 right_weight,
               PixelNode* out) {
  static_assert(kMeanBits == 24, "means are not rounded");
  const Float8 left_weight = 1 - right_weight;
  const Float8 left_mean = Load8(left.mean + lane);
  const Float8 difference = Load8(right.mean + lane) - left_mean;
  const Float8 msd =
      (left_weight * Load8(left.msd + lane) + right_weight * Load8(right.msd + lane)) +
      (left_weight * right_weight) * (difference * difference);
  Store8(out->mean + lane, left_mean + difference * right_weight);
  Store8(out->msd + lane, RoundMsd(msd));
}

Moments8 LoadLanes(const PixelNode& node, int lane) {
  return {Load8(node.mean + lane), Load8(node.msd + lane)};
}
void StoreLanes(const Moments8& moments, int lane, PixelNode* node) {
  Store8(node->mean + lane, moments.mean);
  Store8(node->msd + lane, moments.msd);
}

// The lanes of the other half's radiance.
Float8 SwapHalves(Float8 radiance) {
  return __builtin_shufflevector(radiance, radiance, 4, 5, 6, 7, 0, 1, 2, 3);
}

// Round a node that is rounded: few are.
[[gnu::noinline]] void RoundRadiance(SampleRange range, uint32_t pixel_hash, PixelNode* node) {
  const NodeRounding rounding = RoundingOf(range, false);
  Moments8 moments = LoadLanes(*node, 0);
  Moments8 other = {SwapHalves(moments.mean), SwapHalves(moments.msd)};
  RoundHalves(rounding, UInt8{} + pixel_hash, &moments, &other);
  StoreLanes(moments, 0, node);
}

[[gnu::noinline]] void RoundFeatures(SampleRange range, uint32_t pixel_hash, PixelNode* node) {
  const NodeRounding rounding = RoundingOf(range, true);
  Moments8 halves[] = {LoadLanes(*node, FeatureLane(0)), LoadLanes(*node, FeatureLane(1))};
  RoundHalves(rounding, UInt8{} + pixel_hash, &halves[0], &halves[1]);
  for (int half = 0; half < kNumHalves; ++half) StoreLanes(halves[half], FeatureLane(half), node);
}

// Joins the radiance of two nodes of at least two samples each: equal counts.
void FoldRadiance(const PixelNode& left, const PixelNode& right, PixelNode* out) {
  FoldLanes(left, right, 0, Float8{} + 0.5f, out);
  for (int half = 0; half < kNumHalves; ++half) {
    out->later_hits[half] = left.later_hits[half] + right.later_hits[half];
  }
}

// Joins the features of two nodes whose samples all carry them: only hits differ. Of the sky there
// is nothing to join but votes for no id.
void FoldFeatures(const PixelNode& left, const PixelNode& right, PixelNode* out) {
  const bool blank = left.blank && right.blank;
  if (blank && out->blank) {
    for (int half = 0; half < kNumHalves; ++half) {
      out->vote[half].votes = left.vote[half].votes + right.vote[half].votes;
    }
    return;
  }
  alignas(32) float right_weight[kNumLanes];
  for (float& weight : right_weight) weight = 0.5f;
  for (int half = 0; half < kNumHalves; ++half) {
    right_weight[FeatureLane(half) + kDepthFeature] =
        RightWeight(static_cast<int32_t>(left.hits[half]), static_cast<int32_t>(right.hits[half]));
  }
  for (int lane = kFeatureLane; lane < kNumLanes; lane += kFloat8Lanes) {
    FoldLanes(left, right, lane, Load8(right_weight + lane), out);
  }
  for (int half = 0; half < kNumHalves; ++half) {
    out->hits[half] = left.hits[half] + right.hits[half];
    out->vote[half] = FoldVotes(left.vote[half], right.vote[half]);
  }
  out->blank = blank;
}

void CopyFeatures(const PixelNode& from, PixelNode* to) {
  for (int lane = kFeatureLane; lane < kNumLanes; lane += kFloat8Lanes) {
    StoreLanes(LoadLanes(from, lane), lane, to);
  }
  for (int half = 0; half < kNumHalves; ++half) {
    to->hits[half] = from.hits[half];
    to->vote[half] = from.vote[half];
  }
  to->blank = from.blank;
}

}  // namespace

struct PixelFolder::State {
  int x = 0, y = 0;
  uint32_t hash = 0;  // of the pixel
  SampleRange range;
  int64_t feature_end = kAllFeatures;
  int64_t num_added = 0;
  // nodes[k] waits for its sibling while bit k of the number of pairs is set; it spans 2^k pairs. A
  // pair is two samples, one in each half, of no deviation: nodes[0], or `pair` while that waits.
  // The features of nodes that begin at or after feature_end are not read.
  PixelNode nodes[kNumLevels] = {};
  PixelNode pair = {};
  PixelNode joined = {};  // on its way up
};

PixelFolder::PixelFolder() : state_(std::make_unique<State>()) {}
PixelFolder::~PixelFolder() = default;

void PixelFolder::Begin(int x, int y, SampleRange range, int64_t feature_end) {
  TESSERA_CHECK(range.IsNode() && range.end <= kSamplesMax && IsFeatureEnd(feature_end));
  state_->x = x;
  state_->y = y;
  state_->hash = PixelHash(x, y);
  state_->range = range;
  state_->feature_end = feature_end;
  state_->num_added = 0;
  for (PixelNode* node : {&state_->nodes[0], &state_->pair}) *node = PixelNode{};
}

void PixelFolder::Add(const PixelSample& sample) {
  State& s = *state_;
  const uint64_t num_pairs = static_cast<uint64_t>(s.num_added) / 2;
  const int64_t index = s.range.begin + s.num_added++;
  const int half = static_cast<int>(index & 1);
  PixelNode* pair = (num_pairs & 1) == 0 ? &s.nodes[0] : &s.pair;
  SetRadiance(sample, half, pair);
  const bool has_features = index < s.feature_end;
  if (has_features) {
    SetFeatures(sample, half, pair);
  } else {
    pair->later_hits[half] = sample.depth > 0 ? 1 : 0;
  }
  if (half == 0) return;

  // The two samples fill the two halves of one node; join it with the siblings that wait for it.
  if (has_features) pair->blank = IsBlank(*pair);
  const SampleRange pair_range{index - 1, index + 1};
  if (IsRounded(pair_range)) {
    RoundRadiance(pair_range, s.hash, pair);
    if (has_features) RoundFeatures(pair_range, s.hash, pair);
  }
  const PixelNode* newest = pair;
  const int num_siblings = std::countr_one(num_pairs);
  int64_t newest_begin = index - 1;
  for (int level = 0; level < num_siblings; ++level) {
    PixelNode* joined = level + 1 == num_siblings ? &s.nodes[num_siblings] : &s.joined;
    FoldRadiance(s.nodes[level], *newest, joined);
    const int64_t left_begin = newest_begin - (int64_t{2} << level);
    const bool is_rounded = IsRounded({left_begin, index + 1});
    if (is_rounded) RoundRadiance({left_begin, index + 1}, s.hash, joined);
    if (newest_begin < s.feature_end) {
      FoldFeatures(s.nodes[level], *newest, joined);
      if (is_rounded) RoundFeatures({left_begin, index + 1}, s.hash, joined);
    } else if (left_begin < s.feature_end) {
      // Later samples leave the features of what lies left of them as they are.
      CopyFeatures(s.nodes[level], joined);
    }
    newest = joined;
    newest_begin = left_begin;
  }
}

void PixelFolder::Store(TileStatistics* tile) const {
  const State& s = *state_;
  TESSERA_CHECK(tile->range() == s.range && s.num_added == s.range.size());
  TESSERA_CHECK(tile->feature_end() == s.feature_end);
  TESSERA_CHECK(tile->window().Contains(s.x, s.y));
  const PixelNode& node =
      s.nodes[std::max(0, std::countr_zero(static_cast<uint64_t>(s.num_added)) - 1)];
  const size_t pixel = static_cast<size_t>(tile->window().IndexOf(s.x, s.y));
  for (int half = 0; half < kNumHalves; ++half) {
    const auto store = [&](int lane, int mean_plane, int msd_plane) {
      tile->MutableFloats(half, mean_plane)[pixel] = node.mean[lane];
      tile->MutableFloats(half, msd_plane)[pixel] = node.msd[lane];
    };
    for (int c = 0; c < 3; ++c) {
      store(RadianceLane(half) + c, kRadianceMean + c, kRadianceMsd + c);
    }
    tile->MutableCounts(half, kLaterHits)[pixel] = node.later_hits[half];
    if (!tile->has_features()) continue;
    for (int c = 0; c < 3; ++c) {
      store(FeatureLane(half) + c, kAlbedoMean + c, kAlbedoMsd + c);
      store(FeatureLane(half) + 3 + c, kNormalMean + c, kNormalMsd + c);
    }
    store(FeatureLane(half) + kDepthFeature, kDepthMean, kDepthMsd);
    tile->MutableCounts(half, kHits)[pixel] = node.hits[half];
    tile->MutableCounts(half, kMaterialId)[pixel] = node.vote[half].id;
    tile->MutableCounts(half, kIdVotes)[pixel] = node.vote[half].votes;
  }
}

}  // namespace tessera
