#include "worker/integrator/light_bvh.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>

#include "worker/integrator/ablation.h"
#include "worker/integrator/portable_math.h"

namespace tessera {
namespace {

constexpr int kBins = 12;
// Below this depth nodes are halved by count, so that no recursion goes deep.
constexpr int kDepthByCost = 30;
// Cosines' own errors must not make a light unreachable that is not.
constexpr float kCosineSlack = 1e-4f;
// In the denominator, of the squared radius of a node: near its centre a cluster is no point.
constexpr float kNearShare = 0.5f;
// Of intensities and importances, so that their sums stay finite.
constexpr float kIntensityMax = 1e25f, kImportanceMax = 1e36f;

float Sine(float cosine) { return std::sqrt(Clamp01(1 - cosine * cosine)); }
SinCos<float> SinCosOf(float radians) { return SinCosTurns(radians * (1 / kTwoPiFloat)); }

// The smallest cone about two; the result's cosine is -1 if that is more than a half-space needs.
void JoinCones(LightBounds* a, const LightBounds& b) {
  V3f b_axis = b.axis;
  if (a->back_share == 1 && b.back_share == 1 && a->axis.dot(b_axis) < 0) b_axis = -b_axis;
  const float between = ArcCos(a->axis.dot(b_axis));
  const float spread_a = ArcCos(a->cos_spread), spread_b = ArcCos(b.cos_spread);
  if (between + spread_b <= spread_a) return;
  if (between + spread_a <= spread_b) {
    a->axis = b_axis;
    a->cos_spread = b.cos_spread;
    return;
  }
  const float spread = 0.5f * (spread_a + spread_b + between) + kCosineSlack;
  const float sine = SinCosOf(between).sin;
  if (spread >= kPiFloat || !(sine > 1e-4f)) {
    a->cos_spread = sine > 1e-4f || between > 1 ? -1.f : SinCosOf(std::min(spread, kPiFloat)).cos;
    return;
  }
  const float turn = spread - spread_a;
  a->axis =
      Unit(a->axis * (SinCosOf(between - turn).sin / sine) + b_axis * (SinCosOf(turn).sin / sine));
  a->cos_spread = SinCosOf(spread).cos;
}

void Join(LightBounds* a, const LightBounds& b) {
  if (!(b.intensity > 0)) return;
  if (!(a->intensity > 0)) {
    *a = b;
    return;
  }
  for (int c = 0; c < 3; ++c) {
    a->low[c] = std::min(a->low[c], b.low[c]);
    a->high[c] = std::max(a->high[c], b.high[c]);
  }
  JoinCones(a, b);
  a->cos_emission = std::min(a->cos_emission, b.cos_emission);
  a->back_share = std::max(a->back_share, b.back_share);
  a->intensity = std::min(a->intensity + b.intensity, kIntensityMax);
}

// Conty Estevez & Kulla's surface area orientation heuristic: intensity x area x the directions'
// measure (eq. 1).
double Cost(const LightBounds& b) {
  if (!(b.intensity > 0)) return 0;
  const V3f size = b.high - b.low;
  const double area = double{size.x} * size.y + double{size.y} * size.z + double{size.z} * size.x;
  const float spread = ArcCos(b.cos_spread);
  const float reach = std::min(spread + ArcCos(b.cos_emission), kPiFloat);
  const SinCos<float> s = SinCosOf(spread);
  const double solid =
      2 * kPiDouble * (1 - s.cos) +
      kPiDouble / 2 *
          (2 * reach * s.sin - SinCosOf(spread - 2 * reach).cos - 2 * spread * s.sin + s.cos);
  // A flat or single cluster still costs by its extent.
  const double extent = double{size.x} * size.x + double{size.y} * size.y + double{size.z} * size.z;
  return b.intensity * (area + 0.01 * extent) * solid;
}

V3f CentreOf(const LightBounds& b) { return (b.low + b.high) * 0.5f; }

// Sorts the members along the box's longest axis so that the first `result` make the first child.
size_t SplitMembers(std::span<const LightBounds> lights, bool by_cost,
                    std::span<uint32_t> members) {
  V3f low = CentreOf(lights[members[0]]), high = low;
  for (uint32_t m : members) {
    const V3f centre = CentreOf(lights[m]);
    for (int c = 0; c < 3; ++c) {
      low[c] = std::min(low[c], centre[c]);
      high[c] = std::max(high[c], centre[c]);
    }
  }
  const V3f size = high - low;
  const int axis = size.x >= size.y && size.x >= size.z ? 0 : (size.y >= size.z ? 1 : 2);
  std::sort(members.begin(), members.end(), [&](uint32_t a, uint32_t b) {
    const float ka = CentreOf(lights[a])[axis], kb = CentreOf(lights[b])[axis];
    return ka != kb ? ka < kb : a < b;
  });
  const size_t half = members.size() / 2;
  if (!by_cost || members.size() <= 2 || !(size[axis] > 0)) return half;
  // Bins of equal width along the axis; costs of what lies before and behind each border.
  std::array<LightBounds, kBins> bins;
  std::array<size_t, kBins> counts = {};
  for (uint32_t m : members) {
    const float at = (CentreOf(lights[m])[axis] - low[axis]) / size[axis];
    const int bin = std::min(static_cast<int>(at * kBins), kBins - 1);
    Join(&bins[bin], lights[m]);
    ++counts[bin];
  }
  std::array<double, kBins> behind = {};
  LightBounds joined;
  for (int i = kBins - 1; i > 0; --i) {
    Join(&joined, bins[i]);
    behind[i] = Cost(joined);
  }
  joined = LightBounds();
  double least = std::numeric_limits<double>::infinity();
  size_t before = 0, best = half;
  for (int i = 1; i < kBins; ++i) {
    Join(&joined, bins[i - 1]);
    before += counts[i - 1];
    const double cost = Cost(joined) + behind[i];
    if (before == 0 || before == members.size() || cost >= least) continue;
    least = cost;
    best = before;
  }
  return best;
}

// Eight numbers at once; the same bits in any width of SIMD.
using Float8 = float __attribute__((vector_size(32)));

inline Float8 Load8(const float* from) {
  Float8 v;
  std::memcpy(&v, from, sizeof(v));
  return v;
}
inline Float8 Max(Float8 a, Float8 b) { return a > b ? a : b; }
inline Float8 Min(Float8 a, Float8 b) { return a < b ? a : b; }
inline Float8 Root(Float8 v) {
  for (int i = 0; i < 8; ++i) v[i] = std::sqrt(v[i]);
  return v;
}
inline Float8 SineOf(Float8 cosine) { return Root(Max(1 - cosine * cosine, Float8{})); }

}  // namespace

LightBvh::LightBvh(std::span<const LightBounds> lights) : places_(lights.size()) {
  std::vector<uint32_t> members;
  for (uint32_t i = 0; i < lights.size(); ++i) {
    if (lights[i].intensity > 0) members.push_back(i);
  }
  if (members.empty()) return;
  std::vector<Twig> twigs;
  twigs.reserve(2 * members.size());
  Gather(twigs, BuildTwigs(lights, members, 0, &twigs));
}

int32_t LightBvh::BuildTwigs(std::span<const LightBounds> lights, std::span<uint32_t> members,
                             int depth, std::vector<Twig>* twigs) {
  const int32_t twig = static_cast<int32_t>(twigs->size());
  twigs->emplace_back();
  if (members.size() == 1) {
    const int32_t light = static_cast<int32_t>(members[0]);
    (*twigs)[twig] = {lights[members[0]], 0, {~light, ~light}};
    return twig;
  }
  const size_t split = SplitMembers(lights, depth < kDepthByCost, members);
  const int32_t first = BuildTwigs(lights, members.first(split), depth + 1, twigs);
  const int32_t second = BuildTwigs(lights, members.subspan(split), depth + 1, twigs);
  LightBounds bounds = (*twigs)[first].bounds;
  Join(&bounds, (*twigs)[second].bounds);
  (*twigs)[twig] = {bounds, Cost(bounds), {first, second}};
  return twig;
}

// Makes wide nodes: of the twigs that a node holds, the costliest is replaced by its children until
// the node is full.
void LightBvh::Gather(const std::vector<Twig>& twigs, int32_t root) {
  struct Pending {
    int32_t twig, parent, slot;
  };
  std::vector<Pending> pending = {{root, -1, 0}};
  for (size_t next = 0; next < pending.size(); ++next) {
    const Pending from = pending[next];
    const int32_t index = static_cast<int32_t>(nodes_.size());
    nodes_.emplace_back();
    Node& node = nodes_.back();
    node = Node{};
    node.parent = from.parent;
    node.slot = from.slot;
    if (from.parent >= 0) nodes_[from.parent].child[from.slot] = index;
    std::array<int32_t, kWidth> held = {from.twig};
    int count = 1;
    while (count < kWidth) {
      int costliest = -1;
      for (int i = 0; i < count; ++i) {
        if (twigs[held[i]].children[0] < 0) continue;
        if (costliest < 0 || twigs[held[i]].cost > twigs[held[costliest]].cost) costliest = i;
      }
      if (costliest < 0) break;
      const Twig& opened = twigs[held[costliest]];
      held[costliest] = opened.children[0];
      held[count++] = opened.children[1];
    }
    for (int i = 0; i < count; ++i) {
      const Twig& twig = twigs[held[i]];
      SetChild(twig.bounds, i, &node);
      node.child[i] = twig.children[0];
      if (twig.children[0] < 0) {
        places_[~twig.children[0]] = {index, i};
      } else {
        pending.push_back({held[i], index, i});
      }
    }
  }
}

void LightBvh::SetChild(const LightBounds& b, int slot, Node* node) {
  const V3f centre = CentreOf(b), half = (b.high - b.low) * 0.5f;
  node->centre_x[slot] = centre.x;
  node->centre_y[slot] = centre.y;
  node->centre_z[slot] = centre.z;
  node->radius[slot] = std::sqrt(half.dot(half));
  node->axis_x[slot] = b.axis.x;
  node->axis_y[slot] = b.axis.y;
  node->axis_z[slot] = b.axis.z;
  node->cos_spread[slot] = b.cos_spread;
  node->sin_spread[slot] = Sine(b.cos_spread);
  node->cos_emission[slot] = b.cos_emission;
  node->back_share[slot] = b.back_share;
  node->intensity[slot] = std::min(b.intensity, kIntensityMax);
}

// Conty Estevez & Kulla, eq. 3: intensity x the best cosines that the bounds allow, at the emitter
// and at the receiver, over squared distance.
float LightBvh::Weigh(const Node& node, const LightReceiver& receiver, Lanes& weights) {
  const Float8 zero = {}, one = zero + 1, least = zero + kCosineSlack;
  const Float8 x = Load8(node.centre_x) - receiver.position.x;
  const Float8 y = Load8(node.centre_y) - receiver.position.y;
  const Float8 z = Load8(node.centre_z) - receiver.position.z;
  const Float8 radius = Load8(node.radius);
  const Float8 distance2 = Max(x * x + y * y + z * z, zero + 1e-30f);
  const Float8 inverse = 1 / Root(distance2);
  const Float8 sin_extent = Min(radius * inverse, one), cos_extent = SineOf(sin_extent);
  // At the receiver.
  Float8 cos_i = (x * receiver.normal.x + y * receiver.normal.y + z * receiver.normal.z) * inverse;
  if (receiver.transmits) cos_i = cos_i < zero ? -cos_i : cos_i;
  const Float8 lowered = cos_i * cos_extent + SineOf(cos_i) * sin_extent;
  Float8 received = cos_i > cos_extent ? one : lowered;
  received = received > -least ? Max(received, least) : zero;
  // At the emitter, about its axis and about the opposite one. Angles are subtracted twice: the
  // axis's spread and the box's extent.
  const Float8 cos_axis =
      -(x * Load8(node.axis_x) + y * Load8(node.axis_y) + z * Load8(node.axis_z)) * inverse;
  const Float8 sin_axis = SineOf(cos_axis);
  const Float8 cos_spread = Load8(node.cos_spread), sin_spread = Load8(node.sin_spread);
  const Float8 reach = Load8(node.cos_emission) - kCosineSlack;
  const auto emitted = [&](Float8 cosine) {
    const Float8 cos_off = cosine * cos_spread + sin_axis * sin_spread;
    const Float8 sin_off = sin_axis * cos_spread - cosine * sin_spread;
    Float8 best = cos_off * cos_extent + sin_off * sin_extent;
    best = cos_off > cos_extent ? one : best;
    best = cosine > cos_spread ? one : best;
    return best < reach ? zero : Max(best, least);
  };
  Float8 sent = Max(emitted(cos_axis), emitted(-cos_axis) * Load8(node.back_share));
  // From inside a cluster all may be in sight.
  const auto inside = distance2 <= radius * radius;
  sent = inside ? one : sent;
  received = inside ? one : received;
  const Float8 nearest2 = Max(distance2, radius * radius * kNearShare);
  Float8 importance =
      Min(Load8(node.intensity) * received * sent / nearest2, zero + kImportanceMax);
  if (!Steps().light_tree) importance = Min(Load8(node.intensity), zero + kImportanceMax);
  std::memcpy(weights, &importance, sizeof(importance));
  float total = 0;
  for (float w : weights) total += w;
  return total;
}

int LightBvh::Choose(const LightReceiver& receiver, float u, float* probability) const {
  *probability = 1;
  if (empty()) return -1;
  for (int32_t index = 0; index >= 0;) {
    const Node& node = nodes_[index];
    alignas(32) Lanes weights;
    const float total = Weigh(node, receiver, weights);
    if (!(total > 0)) return -1;
    float left = u * total;
    int slot = -1;
    for (int i = 0; i < kWidth; ++i) {
      if (!(weights[i] > 0)) continue;
      slot = i;
      if (left < weights[i]) break;
      left -= weights[i];
    }
    u = std::min(left / weights[slot], 0x1.fffffep-1f);
    *probability *= weights[slot] / total;
    index = node.child[slot];
    if (index < 0) return ~index;
  }
  return -1;
}

float LightBvh::Probability(const LightReceiver& receiver, int light) const {
  // From the root downwards, so that the product's bits are Choose's.
  std::array<Place, 64> path;
  int depth = 0;
  for (Place at = places_[light]; at.node >= 0;
       at = {nodes_[at.node].parent, nodes_[at.node].slot}) {
    path[depth++] = at;
  }
  if (depth == 0) return 0;
  float probability = 1;
  while (depth-- > 0) {
    alignas(32) Lanes weights;
    const float total = Weigh(nodes_[path[depth].node], receiver, weights);
    if (!(total > 0)) return 0;
    probability *= weights[path[depth].slot] / total;
  }
  return probability;
}

int64_t LightBvh::memory_bytes() const {
  return static_cast<int64_t>(sizeof(Node) * nodes_.size() + sizeof(Place) * places_.size());
}

}  // namespace tessera
