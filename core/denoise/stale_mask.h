// Which pixels of a plane have to be made anew, for certain or perhaps.
#pragma once

#include <cstdint>
#include <vector>

#include "core/base/pixel_rect.h"

namespace tessera {

class StaleMask {
 public:
  // All pixels of `bounds` are stale.
  explicit StaleMask(const PixelRect& bounds);

  // Makes what of `rect` lies in the bounds stale.
  void Mark(const PixelRect& rect);
  // Makes what of `rect` lies in the bounds and is not stale doubtful: stale if something comes of
  // the stale pixels around it.
  void Doubt(const PixelRect& rect);
  // Ends the doubts in `rect`, whose stale pixels are taken: what has a stale pixel within
  // radius_px becomes stale, nothing else is.
  void Settle(const PixelRect& rect, int radius_px);
  // Nothing in `rect` is stale or doubtful.
  void Clear(const PixelRect& rect);
  // Appends to *parts disjoint rectangles inside rect, at most side_max_px wide and high, that
  // cover its stale pixels, which are stale no more. They hold few others: as many as pay off when
  // a rectangle costs as much as itself expanded by border_px.
  void Take(const PixelRect& rect, int side_max_px, int border_px, std::vector<PixelRect>* parts);

  int64_t bytes() const { return static_cast<int64_t>(states_.capacity()); }

 private:
  // The smallest rectangle around the stale pixels in `rect`.
  PixelRect Trim(const PixelRect& rect) const;

  const PixelRect bounds_;
  std::vector<uint8_t> states_;  // row-major over the bounds
};

}  // namespace tessera
