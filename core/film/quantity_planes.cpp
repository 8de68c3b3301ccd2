#include "core/film/quantity_planes.h"

#include <algorithm>
#include <bit>
#include <cstring>

#include "core/film/node_rounding.h"

namespace tessera {
namespace {

// The biased exponent of the greatest power of two that a float is a multiple of; of 0 the greatest
// there is, 0 for denormals.
uint32_t MultipleOf(uint32_t word) {
  const uint32_t exponent = (word >> kFractionBits) & kExponentMask;
  if ((word & ~kFloatSignBit) == 0) return kExponentMask;
  const auto num_zeros = static_cast<uint32_t>(std::countr_zero(word | 1u << kFractionBits));
  return exponent + num_zeros <= kFractionBits ? 0 : exponent + num_zeros - kFractionBits;
}

// A word of a plane that may be floats.
uint32_t WordAt(const uint32_t* from) {
  uint32_t word;
  std::memcpy(&word, from, sizeof(word));
  return word;
}

}  // namespace

NodeRounding RoundingOf(const Quantity& quantity, const TileStatistics& tile) {
  return quantity.first_plane < kNumRadiancePlanes ? RoundingOf(tile.range(), false)
                                                   : RoundingOf(tile.feature_range(), true);
}

bool HasPairUnits(const Quantity& quantity, const TileStatistics& tile) {
  return quantity.is_msd && RoundingOf(quantity, tile).kind == NodeRounding::Kind::kPair;
}

void QuantityPlanes::Resize(size_t num_pixels) {
  for (int half = 0; half < kNumHalves; ++half) {
    for (int channel = 0; channel < kNumChannelsMax; ++channel) {
      copies_[half][channel].resize(num_pixels);
      codes[half][channel].resize(num_pixels);
    }
  }
  for (std::vector<uint32_t>& of_channel : units) of_channel.resize(num_pixels);
}

void QuantityPlanes::Load(const Quantity& quantity, const TileStatistics& tile) {
  for (int half = 0; half < kNumHalves; ++half) {
    for (int channel = 0; channel < quantity.num_channels; ++channel) {
      const int plane = quantity.first_plane + channel;
      const void* from = plane < kFirstCountPlane
                             ? static_cast<const void*>(tile.Floats(half, plane).data())
                             : tile.Counts(half, plane - kFirstCountPlane).data();
      std::vector<uint32_t>& copy = copies_[half][channel];
      std::memcpy(copy.data(), from, copy.size() * sizeof(uint32_t));
      words[half][channel] = copy;
    }
  }
}

std::span<uint32_t> QuantityPlanes::Overwrite(const Quantity& quantity, int half, int channel,
                                              TileStatistics* tile) {
  const int plane = quantity.first_plane + channel;
  std::span<uint32_t> memory;
  if (HasPairUnits(quantity, *tile)) {
    memory = copies_[half][channel];
  } else if (plane < kFirstCountPlane) {
    const std::span<float> floats = tile->FloatsOf(half, plane).Overwrite();
    memory = {reinterpret_cast<uint32_t*>(floats.data()), floats.size()};
  } else {
    memory = tile->CountsOf(half, plane - kFirstCountPlane).Overwrite();
  }
  words[half][channel] = memory;
  return memory;
}

void QuantityPlanes::SetConstant(const Quantity& quantity, int half, int channel, uint32_t word,
                                 TileStatistics* tile) {
  const int plane = quantity.first_plane + channel;
  if (HasPairUnits(quantity, *tile)) {
    std::ranges::fill(copies_[half][channel], word);
    words[half][channel] = copies_[half][channel];
  } else if (plane < kFirstCountPlane) {
    TilePlane<float>& floats = tile->FloatsOf(half, plane);
    floats.SetConstant(std::bit_cast<float>(word));
    words[half][channel] = {reinterpret_cast<const uint32_t*>(floats.values().data()),
                            floats.size()};
  } else {
    TilePlane<uint32_t>& counts = tile->CountsOf(half, plane - kFirstCountPlane);
    counts.SetConstant(word);
    words[half][channel] = counts.values();
  }
}

void QuantityPlanes::LoadPairUnits(const Quantity& quantity, const TileStatistics& tile) {
  const uint32_t difference_bits = RoundingOf(quantity, tile).difference_bits;
  for (int channel = 0; channel < quantity.num_channels; ++channel) {
    const int mean_plane = quantity.first_plane - quantity.num_channels + channel;
    const auto a = tile.Floats(0, mean_plane), b = tile.Floats(1, mean_plane);
    std::vector<uint32_t>& copy = copies_[0][channel];
    for (size_t i = 0; i < a.size(); ++i) {
      const uint32_t guess = PairUnits(a[i], b[i], difference_bits);
      copy[i] = std::min({std::max<uint32_t>(guess, kFractionBits) - kFractionBits,
                          MultipleOf(std::bit_cast<uint32_t>(a[i])),
                          MultipleOf(std::bit_cast<uint32_t>(b[i]))});
    }
  }
}

void QuantityPlanes::KeepUnits(const Quantity& quantity, const TileStatistics& tile) {
  const NodeRounding rounding = RoundingOf(quantity, tile);
  for (int channel = 0; channel < quantity.num_channels; ++channel) {
    const uint32_t* const a = words[0][channel].data();
    const uint32_t* const b = words[1][channel].data();
    uint32_t* const units_of_channel = units[channel].data();
    const size_t num_pixels = units[channel].size();
    if (rounding.kind == NodeRounding::Kind::kPair) {
      for (size_t i = 0; i < num_pixels; ++i) {
        units_of_channel[i] = std::min(WordAt(a + i), kExponentMask - 1);
      }
    } else {
      for (size_t i = 0; i < num_pixels; ++i) {
        const uint32_t whole = NoiseUnits((WordAt(a + i) >> kFractionBits) & kExponentMask,
                                          (WordAt(b + i) >> kFractionBits) & kExponentMask,
                                          rounding);
        units_of_channel[i] = std::max<uint32_t>(whole, kFractionBits) - kFractionBits;
      }
    }
  }
}

PlaneContext QuantityPlanes::ContextOf(const Quantity& quantity, int half, int channel,
                                       const TileStatistics& tile) const {
  PlaneContext context;
  context.is_float = quantity.first_plane < kFirstCountPlane;
  context.row_px = tile.window().width();
  const NodeRounding rounding = RoundingOf(quantity, tile);
  if (half > 0) context.other_half = words[0][channel];
  if (quantity.has_guides && channel > 0) {
    context.guide = words[half][channel - 1];
    if (half > 0) context.other_guide = words[0][channel - 1];
  }
  if (HasPairUnits(quantity, tile)) {
    context.is_float = false;
  } else if (quantity.is_msd) {
    context.key_shift = static_cast<uint8_t>(rounding.msd_dropped + 1);
  }
  if (quantity.is_mean && rounding.kind != NodeRounding::Kind::kNone) {
    context.units = units[channel];
  }
  return context;
}

}  // namespace tessera
