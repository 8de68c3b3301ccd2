#include "core/film/pixel_folder.h"

#include <bit>

#include "core/base/check.h"
#include "core/film/fold.h"

namespace tessera {
namespace {

constexpr int kNumChannels = 10;  // of one half: radiance, albedo, normal, depth
constexpr int kDepthChannel = 9;
constexpr int kNumLanes = 24;  // both halves, padded to whole SIMD registers
constexpr int kNumLevels = 32;

// Both halves of one pixel over one node.
struct alignas(32) PixelNode {
  float mean[kNumLanes];
  float msd[kNumLanes];
  uint32_t hits[kNumHalves];
  IdVote vote[kNumHalves];
};

void SetHalf(const PixelSample& sample, int half, PixelNode* node) {
  float* mean = node->mean + half * kNumChannels;
  for (int c = 0; c < 3; ++c) {
    mean[c] = RoundMean(sample.radiance[c]);
    mean[3 + c] = RoundMean(sample.albedo[c]);
    mean[6 + c] = RoundMean(sample.normal[c]);
  }
  const bool hit = sample.depth > 0;
  mean[kDepthChannel] = hit ? RoundMean(sample.depth) : 0;
  node->hits[half] = hit ? 1 : 0;
  node->vote[half] = {sample.material_id, 1};
}

// Joins two nodes of at least two samples each: equal counts, only hits differ.
void FoldNode(const PixelNode& left, const PixelNode& right, PixelNode* out) {
  alignas(32) float right_weight[kNumLanes];
  for (float& weight : right_weight) weight = 0.5f;
  for (int half = 0; half < kNumHalves; ++half) {
    right_weight[half * kNumChannels + kDepthChannel] =
        RightWeight(static_cast<int32_t>(left.hits[half]), static_cast<int32_t>(right.hits[half]));
  }
  for (int i = 0; i < kNumLanes; ++i) {
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
  int64_t num_added = 0;
  PixelNode pair = {};  // the newest two samples, one in each half
  // nodes[k] waits for its sibling while bit k of the number of pairs is set; it spans 2^k pairs.
  PixelNode nodes[kNumLevels] = {};
};

PixelFolder::PixelFolder() : state_(std::make_unique<State>()) {}
PixelFolder::~PixelFolder() = default;

void PixelFolder::Begin(SampleRange range) {
  TESSERA_CHECK(range.IsNode() && range.end <= kSamplesMax);
  state_->range = range;
  state_->num_added = 0;
  state_->pair = PixelNode{};
}

void PixelFolder::Add(const PixelSample& sample) {
  State& s = *state_;
  const int64_t index = s.range.begin + s.num_added++;
  SetHalf(sample, static_cast<int>(index & 1), &s.pair);
  if ((index & 1) == 0) return;

  // The two samples fill the two halves of one node; join it with the siblings that wait for it.
  const PixelNode* newest = &s.pair;
  const uint64_t num_pairs = static_cast<uint64_t>(s.num_added - 1) / 2;
  const int num_siblings = std::countr_one(num_pairs);
  for (int level = 0; level < num_siblings; ++level) {
    FoldNode(s.nodes[level], *newest, &s.nodes[level]);
    newest = &s.nodes[level];
  }
  s.nodes[num_siblings] = *newest;
}

void PixelFolder::Store(int x, int y, TileStatistics* tile) const {
  const State& s = *state_;
  TESSERA_CHECK(tile->range() == s.range && s.num_added == s.range.size());
  TESSERA_CHECK(tile->window().Contains(x, y));
  const PixelNode& node =
      s.num_added == 1 ? s.pair : s.nodes[std::countr_zero(static_cast<uint64_t>(s.num_added)) - 1];
  const size_t pixel = static_cast<size_t>(tile->window().IndexOf(x, y));
  for (int half = 0; half < kNumHalves; ++half) {
    const float* mean = node.mean + half * kNumChannels;
    const float* msd = node.msd + half * kNumChannels;
    for (int c = 0; c < 3; ++c) {
      tile->Floats(half, kRadianceMean + c)[pixel] = mean[c];
      tile->Floats(half, kRadianceMsd + c)[pixel] = msd[c];
      tile->Floats(half, kAlbedoMean + c)[pixel] = mean[3 + c];
      tile->Floats(half, kAlbedoMsd + c)[pixel] = msd[3 + c];
      tile->Floats(half, kNormalMean + c)[pixel] = mean[6 + c];
      tile->Floats(half, kNormalMsd + c)[pixel] = msd[6 + c];
    }
    tile->Floats(half, kDepthMean)[pixel] = mean[kDepthChannel];
    tile->Floats(half, kDepthMsd)[pixel] = msd[kDepthChannel];
    tile->Counts(half, kHits)[pixel] = node.hits[half];
    tile->Counts(half, kMaterialId)[pixel] = node.vote[half].id;
    tile->Counts(half, kIdVotes)[pixel] = node.vote[half].votes;
  }
}

}  // namespace tessera
