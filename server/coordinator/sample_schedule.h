// In which order the samples of a frame are asked for: passes over the whole frame that double the
// samples per pixel, [0, 2), [2, 4), [4, 8), ..., so that every moment has an even picture. A pure
// function of the job's settings; ranges never move a bit of the film (C1), only where an early
// stop may fall.
#pragma once

#include <cstdint>

#include "core/base/sample_range.h"

namespace tessera {

class SampleSchedule {
 public:
  // spp >= 1. tile_pixels: of a whole tile; bounds the nodes. fine_epochs: two epochs between
  // powers of two (8, 12, 16, 24, ...), for jobs that may stop early.
  SampleSchedule(int64_t spp, int64_t tile_pixels, bool fine_epochs);

  int64_t spp() const { return spp_; }
  // The end of the epoch that sample `begin` < spp belongs to; at most spp.
  int64_t EpochEnd(int64_t begin) const;
  // The node of the folding tree that is asked for next once all of [0, begin) is handed out: the
  // largest one from `begin` inside its epoch and one lease's size.
  SampleRange NextNode(int64_t begin) const;

 private:
  int64_t spp_;
  int64_t node_size_max_;
  bool fine_epochs_;
};

}  // namespace tessera
