// A half-open range of 0-based indices into a pixel's sample sequence, and its place in the one
// binary tree by which all samples are folded (C1). Node [begin, end) of that tree has a
// power-of-two size and begin is a multiple of it; its two children are its halves.
// Sample i belongs to half i & 1 (0 = A, 1 = B).
#pragma once

#include <bit>
#include <cstdint>
#include <vector>

namespace tessera {

inline constexpr int kNumHalves = 2;

struct SampleRange {
  int64_t begin = 0;
  int64_t end = 0;

  int64_t size() const { return end - begin; }
  bool empty() const { return end <= begin; }
  // Whether the range is one node of the folding tree. Of any two numbers.
  bool IsNode() const {
    return begin >= 0 && end > begin && std::has_single_bit(static_cast<uint64_t>(size())) &&
           (begin & (size() - 1)) == 0;
  }
  // How many of the samples belong to `half`.
  int64_t HalfCount(int half) const { return (end + 1 - half) / 2 - (begin + 1 - half) / 2; }

  friend bool operator==(const SampleRange&, const SampleRange&) = default;
  friend auto operator<=>(const SampleRange&, const SampleRange&) = default;
};

// The fewest nodes of the folding tree that cover `range` exactly, ascending.
inline std::vector<SampleRange> MaximalNodes(SampleRange range) {
  std::vector<SampleRange> nodes;
  while (!range.empty()) {
    const uint64_t left = static_cast<uint64_t>(range.size());
    uint64_t size = std::bit_floor(left);
    if (range.begin != 0) {
      const uint64_t alignment = uint64_t{1}
                                 << std::countr_zero(static_cast<uint64_t>(range.begin));
      if (alignment < size) size = alignment;
    }
    nodes.push_back({range.begin, range.begin + static_cast<int64_t>(size)});
    range.begin += static_cast<int64_t>(size);
  }
  return nodes;
}

}  // namespace tessera
