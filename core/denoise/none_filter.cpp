#include "core/denoise/none_filter.h"

#include "core/denoise/confidence.h"

namespace tessera {

void NoneFilter::Filter(const FramePlanes& planes, const FrameParameters& /*parameters*/,
                        const PixelRect& window, FilteredPlanes* out) const {
  for (int y = window.y_begin; y < window.y_end; ++y) {
    for (int x = window.x_begin; x < window.x_end; ++x) {
      const int64_t from = planes.bounds.IndexOf(x, y);
      const int64_t to = out->bounds.IndexOf(x, y);
      const bool known = planes.samples[from] > 0;
      for (int c = 0; c < 3; ++c) {
        out->color[c][to] = known ? planes.color[c][from] : 0.0f;
        out->error[c][to] = known ? HalfWidth95(planes.variance[c][from]) : kInfinity;
      }
    }
  }
  SetRelativeError(window, out);
}

}  // namespace tessera
