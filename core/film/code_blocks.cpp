#include "core/film/code_blocks.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <utility>

namespace tessera {
namespace {

static_assert(std::endian::native == std::endian::little);

// Codes of one lane in a block. A lane of so many codes of `width` bits is `width` 32-bit words.
constexpr size_t kLaneCodes = 32;
constexpr size_t kLanesMax = 8;
constexpr size_t kBlockCodes = kLaneCodes * kLanesMax;
constexpr int kCodeBits = 32;
constexpr size_t kExceptionsMax = 255;

// Eight words, wherever they lie in memory.
using Lanes [[gnu::vector_size(kLanesMax * sizeof(uint32_t))]] = uint32_t;

Lanes Load(const void* from) {
  Lanes lanes;
  std::memcpy(&lanes, from, sizeof(lanes));
  return lanes;
}

void Store(Lanes lanes, void* to) { std::memcpy(to, &lanes, sizeof(lanes)); }

uint32_t MaskOf(int width) { return width == kCodeBits ? ~0u : (1u << width) - 1; }

// What a block's codes are written with: `width` bits of each, and of `num_exceptions` of them the
// bits above in high_bytes bytes.
struct BlockCoding {
  int width = 0;
  int high_bytes = 1;
  size_t num_exceptions = 0;

  size_t packed_bytes(size_t num_lanes) const {
    return static_cast<size_t>(width) * num_lanes * sizeof(uint32_t);
  }
  size_t exception_bytes() const {
    return num_exceptions * (1 + static_cast<size_t>(high_bytes));
  }
};

// The coding of the fewest bytes.
BlockCoding BestCoding(std::span<const uint32_t> codes, size_t num_lanes) {
  std::array<size_t, kCodeBits + 1> num_of_width = {};
  for (const uint32_t code : codes) ++num_of_width[static_cast<size_t>(std::bit_width(code))];
  int widest = kCodeBits;
  while (widest > 0 && num_of_width[static_cast<size_t>(widest)] == 0) --widest;
  BlockCoding best{.width = widest};
  size_t num_exceptions = 0;
  for (int width = widest - 1; width >= 0; --width) {
    num_exceptions += num_of_width[static_cast<size_t>(width) + 1];
    if (num_exceptions > kExceptionsMax) break;
    const BlockCoding coding{width, (widest - width + 7) / 8, num_exceptions};
    if (coding.packed_bytes(num_lanes) + coding.exception_bytes() <
        best.packed_bytes(num_lanes) + best.exception_bytes()) {
      best = coding;
    }
  }
  return best;
}

// The low bits of all lanes of a whole block; `words` are zero.
void PackLanes(const uint32_t* codes, int width, uint32_t* words) {
  const uint32_t mask = MaskOf(width);
  for (int i = 0; i < static_cast<int>(kLaneCodes) && width > 0; ++i) {
    const int bit = i * width;
    const int shift = bit % kCodeBits;
    uint32_t* const low = words + static_cast<size_t>(bit / kCodeBits) * kLanesMax;
    const Lanes lanes = Load(codes + static_cast<size_t>(i) * kLanesMax) & mask;
    Store(Load(low) | lanes << shift, low);
    if (shift + width <= kCodeBits) continue;
    Store(lanes >> (kCodeBits - shift), low + kLanesMax);
  }
}

// The same of a plane's last block, which may have fewer lanes.
void PackWords(std::span<const uint32_t> codes, int width, size_t num_lanes, uint32_t* words) {
  const uint32_t mask = MaskOf(width);
  for (size_t i = 0; i < codes.size() && width > 0; ++i) {
    const size_t bit = i / num_lanes * static_cast<size_t>(width);
    const size_t word = bit / kCodeBits * num_lanes + i % num_lanes;
    const uint64_t shifted = uint64_t{codes[i] & mask} << (bit % kCodeBits);
    words[word] |= static_cast<uint32_t>(shifted);
    if (shifted >> kCodeBits != 0) words[word + num_lanes] |= static_cast<uint32_t>(shifted >> 32);
  }
}

void AppendBlock(std::span<const uint32_t> codes, std::string* bytes) {
  const size_t num_lanes = (codes.size() + kLaneCodes - 1) / kLaneCodes;
  const BlockCoding coding = BestCoding(codes, num_lanes);
  bytes->push_back(static_cast<char>(coding.width | (coding.high_bytes - 1) << 6));
  bytes->push_back(static_cast<char>(coding.num_exceptions));
  std::array<uint32_t, kBlockCodes> words = {};
  if (codes.size() == kBlockCodes) {
    PackLanes(codes.data(), coding.width, words.data());
  } else {
    PackWords(codes, coding.width, num_lanes, words.data());
  }
  bytes->append(reinterpret_cast<const char*>(words.data()), coding.packed_bytes(num_lanes));
  if (coding.num_exceptions == 0) return;
  std::string high_parts;
  for (size_t i = 0; i < codes.size(); ++i) {
    const uint32_t high = codes[i] >> coding.width;
    if (high == 0) continue;
    bytes->push_back(static_cast<char>(i));
    high_parts.append(reinterpret_cast<const char*>(&high), static_cast<size_t>(coding.high_bytes));
  }
  *bytes += high_parts;
}

// All lanes of a whole block. A function for each width, whose shifts are then constants.
template <int kWidth>
void UnpackLanes(const char* packed, uint32_t* codes) {
  constexpr uint32_t kMask = kWidth == kCodeBits ? ~0u : (1u << kWidth) - 1;
#pragma GCC unroll 32
  for (int i = 0; i < static_cast<int>(kLaneCodes); ++i) {
    const int bit = i * kWidth;
    const int word = bit / kCodeBits, shift = bit % kCodeBits;
    Lanes lanes = Load(packed + static_cast<size_t>(word) * sizeof(Lanes)) >> shift;
    if (shift + kWidth > kCodeBits) {
      lanes |= Load(packed + static_cast<size_t>(word + 1) * sizeof(Lanes)) << (kCodeBits - shift);
    }
    Store(lanes & kMask, codes + static_cast<size_t>(i) * kLanesMax);
  }
}
template <>
void UnpackLanes<0>(const char* /*packed*/, uint32_t* codes) {
  std::fill_n(codes, kBlockCodes, 0u);
}

using UnpackFunction = void (*)(const char* packed, uint32_t* codes);
template <int... kWidths>
constexpr std::array<UnpackFunction, sizeof...(kWidths)> UnpackFunctions(
    std::integer_sequence<int, kWidths...>) {
  return {UnpackLanes<kWidths>...};
}
constexpr auto kUnpackLanes =
    UnpackFunctions(std::make_integer_sequence<int, kCodeBits + 1>());

// The lanes of a plane's last block, which may be fewer.
void UnpackWords(const char* packed, int width, size_t num_lanes, std::span<uint32_t> codes) {
  const uint32_t mask = MaskOf(width);
  const auto word_at = [&](size_t index) {
    uint32_t word;
    std::memcpy(&word, packed + index * sizeof(word), sizeof(word));
    return word;
  };
  for (size_t i = 0; i < codes.size(); ++i) {
    const size_t bit = i / num_lanes * static_cast<size_t>(width);
    const size_t word = bit / kCodeBits * num_lanes + i % num_lanes, shift = bit % kCodeBits;
    uint64_t bits = word_at(word);
    if (shift + static_cast<size_t>(width) > kCodeBits) {
      bits |= uint64_t{word_at(word + num_lanes)} << kCodeBits;
    }
    codes[i] = static_cast<uint32_t>(bits >> shift) & mask;
  }
}

// Adds the bits above `width` of those codes that have any. Returns whether they lie in the block:
// a position in a whole one always does.
template <int kHighBytes>
bool AddHighParts(const char* positions, size_t num_exceptions, int width,
                  std::span<uint32_t> codes) {
  const char* const high_parts = positions + num_exceptions;
  if (codes.size() < kBlockCodes) {
    for (size_t i = 0; i < num_exceptions; ++i) {
      if (static_cast<uint8_t>(positions[i]) >= codes.size()) return false;
    }
  }
  const auto add = [&](size_t i, uint32_t high) {
    codes[static_cast<uint8_t>(positions[i])] |= high << width;
  };
  // Four bytes are quicker to load than three; the last part may be the end of memory.
  constexpr uint32_t kMask = ~0u >> (kCodeBits - 8 * kHighBytes);
  constexpr size_t kNumWithin = (sizeof(uint32_t) + kHighBytes - 1) / kHighBytes;
  size_t i = 0;
  for (; i + kNumWithin <= num_exceptions; ++i) {
    uint32_t high;
    std::memcpy(&high, high_parts + i * kHighBytes, sizeof(high));
    add(i, high & kMask);
  }
  for (; i < num_exceptions; ++i) {
    uint32_t high = 0;
    std::memcpy(&high, high_parts + i * kHighBytes, kHighBytes);
    add(i, high);
  }
  return true;
}

bool ReadBlock(std::string_view* bytes, std::span<uint32_t> codes) {
  if (bytes->size() < 2) return false;
  const auto kind = static_cast<uint8_t>((*bytes)[0]);
  const BlockCoding coding{.width = kind & 0x3f,
                           .high_bytes = 1 + (kind >> 6),
                           .num_exceptions = static_cast<uint8_t>((*bytes)[1])};
  if (coding.width > kCodeBits || (coding.width == kCodeBits && coding.num_exceptions > 0)) {
    return false;
  }
  const size_t num_lanes = (codes.size() + kLaneCodes - 1) / kLaneCodes;
  const size_t packed_bytes = coding.packed_bytes(num_lanes);
  bytes->remove_prefix(2);
  if (bytes->size() < packed_bytes + coding.exception_bytes()) return false;
  if (codes.size() == kBlockCodes) {
    kUnpackLanes[static_cast<size_t>(coding.width)](bytes->data(), codes.data());
  } else if (coding.width == 0) {
    std::ranges::fill(codes, 0);
  } else {
    UnpackWords(bytes->data(), coding.width, num_lanes, codes);
  }
  constexpr decltype(&AddHighParts<1>) kAddHighParts[] = {AddHighParts<1>, AddHighParts<2>,
                                                          AddHighParts<3>, AddHighParts<4>};
  const char* const positions = bytes->data() + packed_bytes;
  if (!kAddHighParts[coding.high_bytes - 1](positions, coding.num_exceptions, coding.width,
                                            codes)) {
    return false;
  }
  bytes->remove_prefix(packed_bytes + coding.exception_bytes());
  return true;
}

}  // namespace

void AppendBlocks(std::span<const uint32_t> codes, std::string* bytes) {
  for (size_t begin = 0; begin < codes.size(); begin += kBlockCodes) {
    AppendBlock(codes.subspan(begin, std::min(kBlockCodes, codes.size() - begin)), bytes);
  }
}

bool ReadBlocks(std::string_view* bytes, std::span<uint32_t> codes) {
  for (size_t begin = 0; begin < codes.size(); begin += kBlockCodes) {
    if (!ReadBlock(bytes, codes.subspan(begin, std::min(kBlockCodes, codes.size() - begin)))) {
      return false;
    }
  }
  return true;
}

}  // namespace tessera
