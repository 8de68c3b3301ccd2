#include "core/base/tile_grid.h"

namespace tessera {

TileGrid::TileGrid(const PixelRect& region, int tile_size)
    : region_(region),
      tile_size_(tile_size),
      num_columns_((region.width() + tile_size - 1) / tile_size),
      num_rows_((region.height() + tile_size - 1) / tile_size) {}

PixelRect TileGrid::WindowOf(int64_t tile_index) const {
  const int column = static_cast<int>(tile_index % num_columns_);
  const int row = static_cast<int>(tile_index / num_columns_);
  return PixelRect::FromSize(region_.x_begin + column * tile_size_,
                             region_.y_begin + row * tile_size_, tile_size_, tile_size_)
      .Intersect(region_);
}

std::vector<int64_t> TileGrid::TilesIn(const PixelRect& rect) const {
  std::vector<int64_t> tiles;
  const PixelRect inside = rect.Intersect(region_);
  if (inside.empty()) return tiles;
  const int column_begin = (inside.x_begin - region_.x_begin) / tile_size_;
  const int column_last = (inside.x_end - 1 - region_.x_begin) / tile_size_;
  const int row_begin = (inside.y_begin - region_.y_begin) / tile_size_;
  const int row_last = (inside.y_end - 1 - region_.y_begin) / tile_size_;
  for (int row = row_begin; row <= row_last; ++row) {
    for (int column = column_begin; column <= column_last; ++column) {
      tiles.push_back(int64_t{row} * num_columns_ + column);
    }
  }
  return tiles;
}

namespace {

// The first `part` of `parts` equal parts of a length, rounded down.
int Share(int length, int part, int parts) {
  return static_cast<int>(int64_t{length} * part / parts);
}

}  // namespace

std::vector<PixelRect> SplitWindows(std::span<const PixelRect> windows, int size_px) {
  std::vector<PixelRect> parts;
  for (const PixelRect& window : windows) {
    if (window.empty()) continue;
    const int columns = (window.width() + size_px - 1) / size_px;
    const int rows = (window.height() + size_px - 1) / size_px;
    for (int row = 0; row < rows; ++row) {
      for (int column = 0; column < columns; ++column) {
        parts.push_back({window.x_begin + Share(window.width(), column, columns),
                         window.y_begin + Share(window.height(), row, rows),
                         window.x_begin + Share(window.width(), column + 1, columns),
                         window.y_begin + Share(window.height(), row + 1, rows)});
      }
    }
  }
  return parts;
}

}  // namespace tessera
