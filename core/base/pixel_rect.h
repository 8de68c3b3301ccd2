// A half-open rectangle of pixels: x right, y down, origin at the frame's top left.
#pragma once

#include <algorithm>
#include <cstdint>

namespace tessera {

struct PixelRect {
  int x_begin = 0;
  int y_begin = 0;
  int x_end = 0;
  int y_end = 0;

  static PixelRect FromSize(int x, int y, int width, int height) {
    return {x, y, x + width, y + height};
  }

  int width() const { return x_end - x_begin; }
  int height() const { return y_end - y_begin; }
  int64_t area() const { return empty() ? 0 : int64_t{width()} * height(); }
  bool empty() const { return x_end <= x_begin || y_end <= y_begin; }

  bool Contains(int x, int y) const {
    return x >= x_begin && x < x_end && y >= y_begin && y < y_end;
  }
  bool Contains(const PixelRect& o) const {
    return o.x_begin >= x_begin && o.x_end <= x_end && o.y_begin >= y_begin && o.y_end <= y_end;
  }
  // Row-major index of (x, y), which must lie inside.
  int64_t IndexOf(int x, int y) const { return int64_t{y - y_begin} * width() + (x - x_begin); }

  PixelRect Intersect(const PixelRect& o) const {
    return {std::max(x_begin, o.x_begin), std::max(y_begin, o.y_begin),
            std::min(x_end, o.x_end), std::min(y_end, o.y_end)};
  }
  PixelRect Expand(int border_px) const {
    return {x_begin - border_px, y_begin - border_px, x_end + border_px, y_end + border_px};
  }

  friend bool operator==(const PixelRect&, const PixelRect&) = default;
};

}  // namespace tessera
