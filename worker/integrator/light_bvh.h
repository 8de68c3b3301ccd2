// A hierarchy over the lights of finite position, which chooses one of them for a receiver about in
// proportion to the light that it sends there unoccluded, in time that grows with the logarithm of
// their number. Conty Estevez & Kulla 2018, "Importance Sampling of Many Lights with Adaptive Tree
// Splitting" (without the splitting): each node bounds positions, directions and intensity.
#pragma once

#include <Imath/ImathVec.h>

#include <cstdint>
#include <span>
#include <vector>

#include "worker/scene/scene.h"

namespace tessera {

// Where and whereto light leaves: from the box, within `emission` of an axis that is itself within
// `spread` of `axis`; angles by their cosines.
struct LightBounds {
  V3f low, high;
  V3f axis = V3f(0, 0, 1);
  float cos_spread = -1;
  float cos_emission = 0;
  float back_share = 0;  // how much leaves about the opposite axis, against the axis; 0 ... 1
  float intensity = 0;   // W/sr at most, of luminance
};

// Who is to be lit. Unit normal; `transmits`: on both sides.
struct LightReceiver {
  V3f position;
  V3f normal;
  bool transmits = false;
};

class LightBvh {
 public:
  LightBvh() = default;
  // Lights without intensity are never chosen. A pure function of its input.
  explicit LightBvh(std::span<const LightBounds> lights);

  bool empty() const { return nodes_.empty(); }
  // The chosen light, and its probability; -1 if none can reach the receiver. `u` in [0, 1).
  int Choose(const LightReceiver& receiver, float u, float* probability) const;
  // With which Choose chooses `light`.
  float Probability(const LightReceiver& receiver, int light) const;
  int64_t memory_bytes() const;

 private:
  static constexpr int kWidth = 8;
  using Lanes = float[kWidth];
  // Up to eight children side by side, for SIMD; unused ones have no intensity.
  struct alignas(32) Node {
    Lanes centre_x, centre_y, centre_z;
    Lanes radius;  // of the box's sphere, m
    Lanes axis_x, axis_y, axis_z;
    Lanes cos_spread, sin_spread, cos_emission, back_share, intensity;
    int32_t child[kWidth];  // a node, or ~light
    int32_t parent;         // -1: the root
    int32_t slot;           // in the parent
  };
  struct Place {
    int32_t node = -1;  // -1: never chosen
    int32_t slot = 0;
  };
  // Of the binary tree that the wide one is made from.
  struct Twig {
    LightBounds bounds;
    double cost;
    int32_t children[2];  // twigs; of a leaf: ~light, ~light
  };

  static int32_t BuildTwigs(std::span<const LightBounds> lights, std::span<uint32_t> members,
                            int depth, std::vector<Twig>* twigs);
  void Gather(const std::vector<Twig>& twigs, int32_t root);
  static void SetChild(const LightBounds& bounds, int slot, Node* node);
  // What each child sends to the receiver, by estimate; returns the sum.
  static float Weigh(const Node& node, const LightReceiver& receiver, Lanes& weights);

  std::vector<Node> nodes_;
  std::vector<Place> places_;  // by light
};

}  // namespace tessera
