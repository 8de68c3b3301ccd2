// Exponential back-off with jitter: how long to wait before the next attempt. Moves no bit of any
// picture.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>

namespace tessera {

class Backoff {
 public:
  Backoff(std::chrono::milliseconds shortest, std::chrono::milliseconds longest, uint64_t seed)
      : shortest_(shortest), longest_(longest), state_(seed) {}

  // Doubles from `shortest` to `longest`, each drawn from [1/2, 1) of that.
  std::chrono::milliseconds Next() {
    const auto full = std::min(longest_, shortest_ * (int64_t{1} << std::min(attempts_, 20)));
    ++attempts_;
    return full / 2 + std::chrono::milliseconds(
                          static_cast<int64_t>(Uniform() * static_cast<double>(full.count() / 2)));
  }
  void Reset() { attempts_ = 0; }

 private:
  // SplitMix64 (Steele, Lea & Flood 2014, "Fast splittable pseudorandom number generators").
  double Uniform() {
    uint64_t z = (state_ += 0x9e3779b97f4a7c15u);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return static_cast<double>((z ^ (z >> 31)) >> 11) * 0x1p-53;
  }

  const std::chrono::milliseconds shortest_;
  const std::chrono::milliseconds longest_;
  uint64_t state_;
  int attempts_ = 0;
};

}  // namespace tessera
