// Which parts of a picture somebody looks at, or waits for.
#pragma once

#include <optional>
#include <vector>

#include "core/base/pixel_rect.h"

namespace tessera {

// The smallest rectangle around both, neither of which is empty.
PixelRect Around(const PixelRect& a, const PixelRect& b);

class Views {
 public:
  // The whole picture.
  static Views Whole();

  // A part of the picture, in frame coordinates; absent: all of it; without pixels: nothing.
  void Add(const std::optional<PixelRect>& region);
  void Add(const Views& other);

  bool empty() const { return !is_whole_ && parts_.empty(); }
  bool is_whole() const { return is_whole_; }
  // Whether they share a pixel with `rect`.
  bool Meets(const PixelRect& rect) const;

 private:
  bool is_whole_ = false;
  // None lies in another. Many are joined into one rectangle around all, so that what a client asks
  // for has a limit.
  std::vector<PixelRect> parts_;
};

}  // namespace tessera
