// Where the statistics lie that a delta will be folded into. A large film is in main memory: it is
// asked for while the delta is read, so that the fold finds it in the cache.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "core/base/sample_range.h"
#include "core/film/film.h"

namespace tessera {

// Addresses alone, which nobody reads or writes: the statistics may be gone. Front to back, as
// memory is quickest.
class FoldTarget {
 public:
  // No memory.
  FoldTarget() = default;
  // The planes of `node` that are joined with those of a delta that has features, or has none, and
  // have memory of their own.
  FoldTarget(const TileStatistics& node, bool with_features);

  // Asks for the next bytes.
  void PrefetchNext(size_t num_bytes);

  size_t num_bytes() const;  // still to be asked for

 private:
  void Add(const void* plane);

  size_t plane_bytes_ = 0;
  std::array<const char*, kNumHalves*(int{kNumFloatPlanes} + int{kNumCountPlanes})> planes_ = {};
  size_t num_planes_ = 0;
  size_t next_plane_ = 0;
  size_t next_byte_ = 0;  // of it
};

// The node of a tile that samples before or after it join; no memory if there is none.
FoldTarget FoldTargetIn(const Film& film, int64_t tile_index, SampleRange range);

}  // namespace tessera
