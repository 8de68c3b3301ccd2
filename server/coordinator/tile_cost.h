// What the samples of one tile have cost, over all deltas that were merged into it. Kept by tile,
// so that it is stored with the tile's samples and speaks of just those after a restart.
#pragma once

#include <cstdint>

namespace tessera {

struct TileCost {
  int64_t rays = 0;
  int64_t delta_bytes = 0;  // on the wire
  int64_t render_ns = 0;    // of one thread

  TileCost& operator+=(const TileCost& other) {
    rays += other.rays;
    delta_bytes += other.delta_bytes;
    render_ns += other.render_ns;
    return *this;
  }
  friend bool operator==(const TileCost&, const TileCost&) = default;
};

}  // namespace tessera
