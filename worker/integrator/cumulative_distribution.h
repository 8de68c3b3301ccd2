// Piecewise-constant distribution over n entries, sampled by inversion, which keeps the
// stratification of the number that it is given.
#pragma once

#include <algorithm>
#include <cstdint>
#include <span>
#include <vector>

namespace tessera {

// Samples entries proportionally to weights from their running sums (n + 1 values, the first 0, the
// last 1). Returns the entry and replaces *u by its position inside the entry, in [0, 1).
inline int SampleRunningSums(std::span<const float> sums, float* u) {
  const int n = static_cast<int>(sums.size()) - 1;
  int first = 0;
  for (int left = n; left > 1;) {
    const int step = left >> 1;
    // The last entry whose running sum is at or below *u; entries of zero width are passed over.
    if (sums[first + step] <= *u) first += step;
    left -= step;
  }
  const float width = sums[first + 1] - sums[first];
  *u = width > 0 ? std::min((*u - sums[first]) / width, 0x1.fffffep-1f) : 0.f;
  return first;
}

// Writes the running sums of `weights` (all >= 0) divided by their total, summed in double.
// A total of zero gives a uniform distribution.
inline std::vector<float> RunningSums(std::span<const double> weights) {
  double total = 0;
  for (double w : weights) total += w;
  const size_t n = weights.size();
  std::vector<float> sums(n + 1, 0.f);
  double sum = 0;
  for (size_t i = 0; i < n; ++i) {
    sum += weights[i];
    sums[i + 1] = static_cast<float>(total > 0 ? sum / total : static_cast<double>(i + 1) / n);
  }
  // Nothing after the last positive weight may be chosen because of rounding.
  for (size_t i = n; i > 0; --i) {
    sums[i] = 1.f;
    if (!(total > 0) || weights[i - 1] > 0) break;
  }
  return sums;
}

}  // namespace tessera
