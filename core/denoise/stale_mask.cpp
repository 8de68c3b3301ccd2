#include "core/denoise/stale_mask.h"

#include <algorithm>
#include <cstring>
#include <utility>

namespace tessera {
namespace {

constexpr uint8_t kFresh = 0, kStale = 1, kDoubtful = 2;

// Not std::replace, which stores by need and so not in vectors.
void Replace(uint8_t* row, int width, uint8_t from, uint8_t to) {
  for (int x = 0; x < width; ++x) row[x] = row[x] == from ? to : row[x];
}

int64_t Cost(const PixelRect& rect, int border_px) {
  return rect.empty() ? 0 : rect.Expand(border_px).area();
}

// Cut at half its width or height.
std::pair<PixelRect, PixelRect> Halves(const PixelRect& rect, bool is_across) {
  PixelRect first = rect, second = rect;
  if (is_across) {
    first.x_end = second.x_begin = rect.x_begin + rect.width() / 2;
  } else {
    first.y_end = second.y_begin = rect.y_begin + rect.height() / 2;
  }
  return {first, second};
}

}  // namespace

StaleMask::StaleMask(const PixelRect& bounds)
    : bounds_(bounds), states_(static_cast<size_t>(bounds.area()), kStale) {}

void StaleMask::Mark(const PixelRect& rect) {
  const PixelRect inside = rect.Intersect(bounds_);
  if (inside.empty()) return;
  for (int y = inside.y_begin; y < inside.y_end; ++y) {
    std::fill_n(states_.begin() + bounds_.IndexOf(inside.x_begin, y), inside.width(), kStale);
  }
}

void StaleMask::Doubt(const PixelRect& rect) {
  const PixelRect inside = rect.Intersect(bounds_);
  if (inside.empty()) return;
  for (int y = inside.y_begin; y < inside.y_end; ++y) {
    uint8_t* const row = states_.data() + bounds_.IndexOf(inside.x_begin, y);
    Replace(row, inside.width(), kFresh, kDoubtful);
  }
}

void StaleMask::Settle(const PixelRect& rect, int radius_px) {
  const PixelRect inside = rect.Intersect(bounds_);
  if (inside.empty()) return;
  std::vector<PixelRect> reached;
  const PixelRect read = inside.Expand(radius_px).Intersect(bounds_);
  for (int y = read.y_begin; y < read.y_end; ++y) {
    for (int x = read.x_begin; x < read.x_end; ++x) {
      const bool is_stale = states_[static_cast<size_t>(bounds_.IndexOf(x, y))] == kStale;
      if (is_stale) reached.push_back(PixelRect::FromSize(x, y, 1, 1).Expand(radius_px));
    }
  }
  for (const PixelRect& near : reached) {
    const PixelRect part = near.Intersect(inside);
    for (int y = part.y_begin; y < part.y_end; ++y) {
      uint8_t* const row = states_.data() + bounds_.IndexOf(part.x_begin, y);
      Replace(row, part.width(), kDoubtful, kStale);
    }
  }
  for (int y = inside.y_begin; y < inside.y_end; ++y) {
    uint8_t* const row = states_.data() + bounds_.IndexOf(inside.x_begin, y);
    Replace(row, inside.width(), kDoubtful, kFresh);
  }
}

void StaleMask::Clear(const PixelRect& rect) {
  const PixelRect inside = rect.Intersect(bounds_);
  if (inside.empty()) return;
  for (int y = inside.y_begin; y < inside.y_end; ++y) {
    std::fill_n(states_.begin() + bounds_.IndexOf(inside.x_begin, y), inside.width(), kFresh);
  }
}

PixelRect StaleMask::Trim(const PixelRect& rect) const {
  PixelRect found{rect.x_end, rect.y_end, rect.x_begin, rect.y_begin};
  for (int y = rect.y_begin; y < rect.y_end; ++y) {
    const uint8_t* const row = states_.data() + bounds_.IndexOf(rect.x_begin, y);
    const auto width = static_cast<size_t>(rect.width());
    const void* const first = std::memchr(row, kStale, width);
    if (first == nullptr) continue;
    const void* const last = memrchr(row, kStale, width);
    found.y_begin = std::min(found.y_begin, y);
    found.y_end = y + 1;
    found.x_begin = std::min(
        found.x_begin, rect.x_begin + static_cast<int>(static_cast<const uint8_t*>(first) - row));
    found.x_end = std::max(
        found.x_end, rect.x_begin + static_cast<int>(static_cast<const uint8_t*>(last) - row) + 1);
  }
  return found;
}

void StaleMask::Take(const PixelRect& rect, int side_max_px, int border_px,
                     std::vector<PixelRect>* parts) {
  const PixelRect inside = rect.Intersect(bounds_);
  if (inside.empty()) return;
  const PixelRect stale = Trim(inside);
  if (stale.empty()) return;
  // Parts of about one size, where one alone would be too large.
  const int columns = (stale.width() + side_max_px - 1) / side_max_px;
  const int rows = (stale.height() + side_max_px - 1) / side_max_px;
  if (columns > 1 || rows > 1) {
    for (int row = 0; row < rows; ++row) {
      for (int column = 0; column < columns; ++column) {
        Take({stale.x_begin + stale.width() * column / columns,
              stale.y_begin + stale.height() * row / rows,
              stale.x_begin + stale.width() * (column + 1) / columns,
              stale.y_begin + stale.height() * (row + 1) / rows},
             side_max_px, border_px, parts);
      }
    }
    return;
  }
  for (const bool is_across : {false, true}) {
    const auto [first, second] = Halves(stale, is_across);
    if (first.empty() || second.empty()) continue;
    if (Cost(Trim(first), border_px) + Cost(Trim(second), border_px) < Cost(stale, border_px)) {
      Take(first, side_max_px, border_px, parts);
      Take(second, side_max_px, border_px, parts);
      return;
    }
  }
  Clear(stale);
  parts->push_back(stale);
}

}  // namespace tessera
