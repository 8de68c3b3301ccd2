// Cuts the rendered region of a frame into square tiles, row by row.
// Tiles exist for handing out work only: no pixel's value depends on them.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/base/pixel_rect.h"

namespace tessera {

class TileGrid {
 public:
  TileGrid() = default;
  // `region` in frame coordinates; tile_size >= 1. Tiles at the right and lower border are cut.
  TileGrid(const PixelRect& region, int tile_size);

  const PixelRect& region() const { return region_; }
  int tile_size() const { return tile_size_; }
  int64_t num_tiles() const { return int64_t{num_columns_} * num_rows_; }
  int num_columns() const { return num_columns_; }

  // The pixels that tile `tile_index` owns, in frame coordinates.
  PixelRect WindowOf(int64_t tile_index) const;
  // Ascending indices of the tiles that share a pixel with `rect`.
  std::vector<int64_t> TilesIn(const PixelRect& rect) const;

 private:
  PixelRect region_;
  int tile_size_ = 1;
  int num_columns_ = 0;
  int num_rows_ = 0;
};

// Cuts each window into as few parts of at most size_px x size_px pixels as there can be, of about
// one size, row by row. size_px >= 1.
std::vector<PixelRect> SplitWindows(std::span<const PixelRect> windows, int size_px);

}  // namespace tessera
