// Random numbers of the simulator: the same on every machine, unlike <random>'s distributions.
#pragma once

#include <cstdint>

namespace tessera {

class SimRandom {
 public:
  explicit SimRandom(uint64_t seed) : state_(seed) {}

  // SplitMix64 (Steele, Lea & Flood 2014, "Fast splittable pseudorandom number generators").
  uint64_t Bits() {
    uint64_t z = (state_ += 0x9e3779b97f4a7c15u);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return z ^ (z >> 31);
  }
  double Uniform() { return static_cast<double>(Bits() >> 11) * 0x1p-53; }
  bool Chance(double probability) { return Uniform() < probability; }
  // In [first, last].
  int64_t Between(int64_t first, int64_t last) {
    return first + static_cast<int64_t>(Bits() % static_cast<uint64_t>(last - first + 1));
  }

 private:
  uint64_t state_;
};

}  // namespace tessera
