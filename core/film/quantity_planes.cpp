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
      words[half][channel].resize(num_pixels);
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
      std::vector<uint32_t>& to = words[half][channel];
      std::memcpy(to.data(), from, to.size() * sizeof(uint32_t));
    }
  }
}

void QuantityPlanes::Store(const Quantity& quantity, TileStatistics* tile) const {
  for (int half = 0; half < kNumHalves; ++half) {
    for (int channel = 0; channel < quantity.num_channels; ++channel) {
      const int plane = quantity.first_plane + channel;
      void* to = plane < kFirstCountPlane
                     ? static_cast<void*>(tile->Floats(half, plane).data())
                     : tile->Counts(half, plane - kFirstCountPlane).data();
      const std::vector<uint32_t>& from = words[half][channel];
      std::memcpy(to, from.data(), from.size() * sizeof(uint32_t));
    }
  }
}

void QuantityPlanes::LoadPairUnits(const Quantity& quantity, const TileStatistics& tile) {
  const uint32_t difference_bits = RoundingOf(quantity, tile).difference_bits;
  for (int channel = 0; channel < quantity.num_channels; ++channel) {
    const int mean_plane = quantity.first_plane - quantity.num_channels + channel;
    const auto a = tile.Floats(0, mean_plane), b = tile.Floats(1, mean_plane);
    for (size_t i = 0; i < a.size(); ++i) {
      const uint32_t guess = PairUnits(a[i], b[i], difference_bits);
      words[0][channel][i] = std::min({std::max<uint32_t>(guess, kFractionBits) - kFractionBits,
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
    std::vector<uint32_t>& of_channel = units[channel];
    if (rounding.kind == NodeRounding::Kind::kPair) {
      for (size_t i = 0; i < of_channel.size(); ++i) {
        of_channel[i] = std::min(a[i], kExponentMask - 1);
      }
    } else {
      for (size_t i = 0; i < of_channel.size(); ++i) {
        const uint32_t whole = NoiseUnits((a[i] >> kFractionBits) & kExponentMask,
                                          (b[i] >> kFractionBits) & kExponentMask,
                                          rounding);
        of_channel[i] = std::max<uint32_t>(whole, kFractionBits) - kFractionBits;
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
