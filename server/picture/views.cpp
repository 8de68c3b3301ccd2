#include "server/picture/views.h"

#include <algorithm>

namespace tessera {
namespace {

constexpr size_t kPartsMax = 64;

}  // namespace

PixelRect Around(const PixelRect& a, const PixelRect& b) {
  return {std::min(a.x_begin, b.x_begin), std::min(a.y_begin, b.y_begin),
          std::max(a.x_end, b.x_end), std::max(a.y_end, b.y_end)};
}

Views Views::Whole() {
  Views views;
  views.is_whole_ = true;
  return views;
}

void Views::Add(const std::optional<PixelRect>& region) {
  if (is_whole_ || (region.has_value() && region->empty())) return;
  if (!region.has_value()) {
    *this = Whole();
    return;
  }
  const auto holds = [&](const PixelRect& part) { return part.Contains(*region); };
  if (std::ranges::any_of(parts_, holds)) return;
  std::erase_if(parts_, [&](const PixelRect& part) { return region->Contains(part); });
  parts_.push_back(*region);
  if (parts_.size() <= kPartsMax) return;
  PixelRect around = parts_.front();
  for (const PixelRect& part : parts_) around = Around(around, part);
  parts_ = {around};
}

void Views::Add(const Views& other) {
  if (other.is_whole_) *this = Whole();
  for (const PixelRect& part : other.parts_) Add(part);
}

bool Views::Meets(const PixelRect& rect) const {
  if (is_whole_) return !rect.empty();
  return std::ranges::any_of(
      parts_, [&](const PixelRect& part) { return !part.Intersect(rect).empty(); });
}

}  // namespace tessera
