// Piecewise-constant distribution over n entries, sampled by inversion, which keeps the
// stratification of the number that it is given.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "worker/integrator/float8_math.h"

namespace tessera {

// Samples one of the entries [first, first + count) proportionally to weights from the running sums
// of all (n + 1 values, the first 0, the last 1); *u must fall among them. Returns the entry and
// replaces *u by its position inside the entry, in [0, 1).
inline int SampleRunningSums(std::span<const float> sums, int first, int count, float* u) {
  while (count > 1) {
    const int step = count >> 1;
    // The last entry whose running sum is at or below *u; entries of zero width are passed over.
    if (sums[first + step] <= *u) first += step;
    count -= step;
  }
  const float width = sums[first + 1] - sums[first];
  *u = width > 0 ? std::min((*u - sums[first]) / width, 0x1.fffffep-1f) : 0.f;
  return first;
}

inline int SampleRunningSums(std::span<const float> sums, float* u) {
  return SampleRunningSums(sums, 0, static_cast<int>(sums.size()) - 1, u);
}

// The same for eight numbers in running sums of their own, all at once, so that their cache misses
// overlap. Writes the entries and their widths.
inline void SampleRunningSums8(const std::array<std::span<const float>, kFloat8Lanes>& sums,
                               Float8* u, std::array<int, kFloat8Lanes>* entries, Float8* widths) {
  std::array<int, kFloat8Lanes> counts;
  int most = 1;
  for (int i = 0; i < kFloat8Lanes; ++i) {
    counts[i] = static_cast<int>(sums[i].size()) - 1;
    most = std::max(most, counts[i]);
  }
  entries->fill(0);
  for (; most > 1; most -= most >> 1) {
    for (int i = 0; i < kFloat8Lanes; ++i) {
      const int step = counts[i] >> 1;
      (*entries)[i] += step & -static_cast<int>(sums[i][(*entries)[i] + step] <= (*u)[i]);
      counts[i] -= step;
    }
  }
  Float8 begin;
  for (int i = 0; i < kFloat8Lanes; ++i) {
    begin[i] = sums[i][(*entries)[i]];
    (*widths)[i] = sums[i][(*entries)[i] + 1] - begin[i];
  }
  *u = *widths > 0 ? Min8((*u - begin) / *widths, Spread8(0x1.fffffep-1f)) : Float8{};
}

// A guide to running sums (Chen & Asau 1974): the entries into which k / num_guides falls,
// k = 0 ... num_guides. num_guides is a power of two, so that u * num_guides is exact.
inline void AppendGuide(std::span<const float> sums, int num_guides, std::vector<uint32_t>* guide) {
  for (int k = 0; k <= num_guides; ++k) {
    float u = std::min(static_cast<float>(k) / static_cast<float>(num_guides), 0x1.fffffep-1f);
    guide->push_back(static_cast<uint32_t>(SampleRunningSums(sums, &u)));
  }
}

// SampleRunningSums, with fewer steps; `guide` is what AppendGuide appended.
inline int SampleGuided(std::span<const float> sums, std::span<const uint32_t> guide, float* u) {
  const size_t k = static_cast<size_t>(*u * static_cast<float>(guide.size() - 1));
  const int first = static_cast<int>(guide[k]), last = static_cast<int>(guide[k + 1]);
  return SampleRunningSums(sums, first, last - first + 1, u);
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
