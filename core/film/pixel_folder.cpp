#include "core/film/pixel_folder.h"

#include <bit>

#include "core/base/check.h"
#include "core/film/fold.h"

namespace tessera {
namespace {

// Lanes of a node: both halves' radiance, then both halves' features (albedo, normal, depth), each
// padded to whole SIMD registers.
constexpr int kNumFeatures = 7;
constexpr int kDepthFeature = 6;
constexpr int kFeatureLane = 8;
constexpr int kNumLanes = 24;
constexpr int kNumLevels = 32;

constexpr int RadianceLane(int half) { return 3 * half; }
constexpr int FeatureLane(int half) { return kFeatureLane + kNumFeatures * half; }

// Both halves of one pixel over one node.
struct alignas(32) PixelNode {
  float mean[kNumLanes];
  float msd[kNumLanes];
  uint32_t later_hits[kNumHalves];
  uint32_t hits[kNumHalves];
  IdVote vote[kNumHalves];
};

void SetRadiance(const PixelSample& sample, int half, PixelNode* node) {
  float* mean = node->mean + RadianceLane(half);
  for (int c = 0; c < 3; ++c) mean[c] = RoundMean(sample.radiance[c]);
}

void SetFeatures(const PixelSample& sample, int half, PixelNode* node) {
  float* mean = node->mean + FeatureLane(half);
  for (int c = 0; c < 3; ++c) {
    mean[c] = RoundMean(sample.albedo[c]);
    mean[3 + c] = RoundMean(sample.normal[c]);
  }
  const bool hit = sample.depth > 0;
  mean[kDepthFeature] = hit ? RoundMean(sample.depth) : 0;
  node->hits[half] = hit ? 1 : 0;
  node->vote[half] = {sample.material_id, 1};
}

// Joins the radiance of two nodes of at least two samples each: equal counts.
void FoldRadiance(const PixelNode& left, const PixelNode& right, PixelNode* out) {
  for (int i = 0; i < kFeatureLane; ++i) {
    float mean, msd;
    FoldMoments(left.mean[i], left.msd[i], right.mean[i], right.msd[i], 0.5f, &mean, &msd);
    out->mean[i] = RoundMean(mean);
    out->msd[i] = RoundMsd(msd);
  }
  for (int half = 0; half < kNumHalves; ++half) {
    out->later_hits[half] = left.later_hits[half] + right.later_hits[half];
  }
}

// Joins the features of two nodes whose samples all carry them: only hits differ.
void FoldFeatures(const PixelNode& left, const PixelNode& right, PixelNode* out) {
  alignas(32) float right_weight[kNumLanes];
  for (float& weight : right_weight) weight = 0.5f;
  for (int half = 0; half < kNumHalves; ++half) {
    right_weight[FeatureLane(half) + kDepthFeature] =
        RightWeight(static_cast<int32_t>(left.hits[half]), static_cast<int32_t>(right.hits[half]));
  }
  for (int i = kFeatureLane; i < kNumLanes; ++i) {
    float mean, msd;
    FoldMoments(left.mean[i], left.msd[i], right.mean[i], right.msd[i], right_weight[i], &mean,
                &msd);
    out->mean[i] = RoundMean(mean);
    out->msd[i] = RoundMsd(msd);
  }
  for (int half = 0; half < kNumHalves; ++half) {
    out->hits[half] = left.hits[half] + right.hits[half];
    out->vote[half] = FoldVotes(left.vote[half], right.vote[half]);
  }
}

}  // namespace

struct PixelFolder::State {
  SampleRange range;
  int64_t feature_end = kAllFeatures;
  int64_t num_added = 0;
  PixelNode pair = {};  // the newest two samples, one in each half
  // nodes[k] waits for its sibling while bit k of the number of pairs is set; it spans 2^k pairs.
  // The features of nodes that begin at or after feature_end are not read.
  PixelNode nodes[kNumLevels] = {};
};

PixelFolder::PixelFolder() : state_(std::make_unique<State>()) {}
PixelFolder::~PixelFolder() = default;

void PixelFolder::Begin(SampleRange range, int64_t feature_end) {
  TESSERA_CHECK(range.IsNode() && range.end <= kSamplesMax && IsFeatureEnd(feature_end));
  state_->range = range;
  state_->feature_end = feature_end;
  state_->num_added = 0;
  state_->pair = PixelNode{};
}

void PixelFolder::Add(const PixelSample& sample) {
  State& s = *state_;
  const int64_t index = s.range.begin + s.num_added++;
  const int half = static_cast<int>(index & 1);
  SetRadiance(sample, half, &s.pair);
  if (index < s.feature_end) {
    SetFeatures(sample, half, &s.pair);
  } else {
    s.pair.later_hits[half] = sample.depth > 0 ? 1 : 0;
  }
  if (half == 0) return;

  // The two samples fill the two halves of one node; join it with the siblings that wait for it.
  const PixelNode* newest = &s.pair;
  const uint64_t num_pairs = static_cast<uint64_t>(s.num_added - 1) / 2;
  const int num_siblings = std::countr_one(num_pairs);
  int64_t newest_begin = index - 1;
  for (int level = 0; level < num_siblings; ++level) {
    FoldRadiance(s.nodes[level], *newest, &s.nodes[level]);
    // Later samples leave the features of what lies left of them as they are.
    if (newest_begin < s.feature_end) FoldFeatures(s.nodes[level], *newest, &s.nodes[level]);
    newest = &s.nodes[level];
    newest_begin -= int64_t{2} << level;
  }
  s.nodes[num_siblings] = *newest;
}

void PixelFolder::Store(int x, int y, TileStatistics* tile) const {
  const State& s = *state_;
  TESSERA_CHECK(tile->range() == s.range && s.num_added == s.range.size());
  TESSERA_CHECK(tile->feature_end() == s.feature_end);
  TESSERA_CHECK(tile->window().Contains(x, y));
  const PixelNode& node =
      s.num_added == 1 ? s.pair : s.nodes[std::countr_zero(static_cast<uint64_t>(s.num_added)) - 1];
  const size_t pixel = static_cast<size_t>(tile->window().IndexOf(x, y));
  for (int half = 0; half < kNumHalves; ++half) {
    const auto store = [&](int lane, int mean_plane, int msd_plane) {
      tile->Floats(half, mean_plane)[pixel] = node.mean[lane];
      tile->Floats(half, msd_plane)[pixel] = node.msd[lane];
    };
    for (int c = 0; c < 3; ++c) {
      store(RadianceLane(half) + c, kRadianceMean + c, kRadianceMsd + c);
    }
    tile->Counts(half, kLaterHits)[pixel] = node.later_hits[half];
    if (!tile->has_features()) continue;
    for (int c = 0; c < 3; ++c) {
      store(FeatureLane(half) + c, kAlbedoMean + c, kAlbedoMsd + c);
      store(FeatureLane(half) + 3 + c, kNormalMean + c, kNormalMsd + c);
    }
    store(FeatureLane(half) + kDepthFeature, kDepthMean, kDepthMsd);
    tile->Counts(half, kHits)[pixel] = node.hits[half];
    tile->Counts(half, kMaterialId)[pixel] = node.vote[half].id;
    tile->Counts(half, kIdVotes)[pixel] = node.vote[half].votes;
  }
}

}  // namespace tessera
