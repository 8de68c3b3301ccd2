// The planes of one quantity of a delta, on their way between TileStatistics and the codes of
// plane_coding.h (docs/delta-format.md).
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/film/node_rounding.h"
#include "core/film/plane_coding.h"
#include "core/film/tile_statistics.h"

namespace tessera {

// Planes of one half: the float planes, then the count planes.
inline constexpr int kFirstCountPlane = kNumFloatPlanes;
inline constexpr int kNumPlanes = kFirstCountPlane + kNumCountPlanes;

// Planes of one quantity share their streams. Colours' channels rise and fall together, so each
// channel guides the next. A mean follows its msd, which tells what it was rounded to.
struct Quantity {
  int first_plane;
  int num_channels;
  bool has_guides;
  bool is_mean;
  bool is_msd;
};
inline constexpr Quantity kQuantities[] = {
    {kRadianceMsd, 3, true, false, true},
    {kRadianceMean, 3, true, true, false},
    {kAlbedoMsd, 3, true, false, true},
    {kAlbedoMean, 3, true, true, false},
    {kNormalMsd, 3, false, false, true},
    {kNormalMean, 3, false, true, false},
    {kDepthMsd, 1, false, false, true},
    {kDepthMean, 1, false, true, false},
    {kFirstCountPlane + kLaterHits, 1, false, false, false},
    {kFirstCountPlane + kHits, 1, false, false, false},
    {kFirstCountPlane + kMaterialId, 1, false, false, false},
    {kFirstCountPlane + kIdVotes, 1, false, false, false},
};
inline constexpr int kNumChannelsMax = 3;

// In both halves, as words and as codes.
class QuantityPlanes {
 public:
  void Resize(size_t num_pixels);

  // Lets `words` be a copy of the tile's planes.
  void Load(const Quantity& quantity, const TileStatistics& tile);
  // Lets `words` be a plane of the tile and gives its memory, for RestorePlane to fill and nobody
  // else to read: floats are among them. Pairs' units are not the tile's: they get memory of their
  // own, and the msds stay as they are.
  std::span<uint32_t> Overwrite(const Quantity& quantity, int half, int channel,
                                TileStatistics* tile);
  // The same for a plane of one word, which it sets.
  void SetConstant(const Quantity& quantity, int half, int channel, uint32_t word,
                   TileStatistics* tile);

  // Puts the units of pairs in the place of half A's msds, which are 0, for the means that follow.
  // The means are the tile's; they are multiples of the units, whatever they are.
  void LoadPairUnits(const Quantity& quantity, const TileStatistics& tile);
  // Sets the units of the means that follow these msds, or pairs' units.
  void KeepUnits(const Quantity& quantity, const TileStatistics& tile);

  // What is known of a plane when channels are visited in order, half A of each first.
  PlaneContext ContextOf(const Quantity& quantity, int half, int channel,
                         const TileStatistics& tile) const;

  std::span<const uint32_t> words[kNumHalves][kNumChannelsMax];
  std::vector<uint32_t> codes[kNumHalves][kNumChannelsMax];
  std::vector<uint32_t> units[kNumChannelsMax];  // see PlaneContext

 private:
  std::vector<uint32_t> copies_[kNumHalves][kNumChannelsMax];
};

// What statistics of the quantity were rounded to.
NodeRounding RoundingOf(const Quantity& quantity, const TileStatistics& tile);

// Whether the quantity's msds are the units of pairs on the wire.
bool HasPairUnits(const Quantity& quantity, const TileStatistics& tile);

}  // namespace tessera
