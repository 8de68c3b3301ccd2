#include "server/coordinator/sample_schedule.h"

#include <algorithm>
#include <bit>

#include "server/coordinator/limits.h"

namespace tessera {

SampleSchedule::SampleSchedule(int64_t spp, int64_t tile_pixels, bool fine_epochs)
    : spp_(spp),
      node_size_max_(static_cast<int64_t>(std::bit_floor(
          static_cast<uint64_t>(std::max<int64_t>(2, kLeaseSamplesMax / tile_pixels))))),
      fine_epochs_(fine_epochs) {}

int64_t SampleSchedule::EpochEnd(int64_t begin) const {
  if (begin < 2) return std::min<int64_t>(2, spp_);
  const auto octave = static_cast<int64_t>(std::bit_floor(static_cast<uint64_t>(begin)));
  const int64_t step = fine_epochs_ && octave >= 4 ? octave / 2 : octave;
  return std::min(spp_, (begin / step + 1) * step);
}

SampleRange SampleSchedule::NextNode(int64_t begin) const {
  int64_t size = static_cast<int64_t>(
      std::bit_floor(static_cast<uint64_t>(EpochEnd(begin) - begin)));
  if (begin > 0) {
    size = std::min(size, int64_t{1} << std::countr_zero(static_cast<uint64_t>(begin)));
  }
  return {begin, begin + std::min(size, node_size_max_)};
}

}  // namespace tessera
