// Folds the samples of one pixel over one node of the folding tree, in the tree's order, as they
// are drawn; what a renderer's inner loop calls. Gives the same bits as merging one-sample
// TileStatistics pairwise.
#pragma once

#include <cstdint>
#include <memory>

#include "core/film/pixel_sample.h"
#include "core/film/tile_statistics.h"

namespace tessera {

class PixelFolder {
 public:
  PixelFolder();
  ~PixelFolder();

  // Begins a node of the frame's pixel (x, y); `range.IsNode()`. Samples from `feature_end` on
  // carry no features (TileStatistics).
  void Begin(int x, int y, SampleRange range, int64_t feature_end = kAllFeatures);
  // The next sample, in ascending order; range.size() calls in all. The sample must be finite
  // (ReplaceNonFinite). Of one without features, radiance and whether depth is positive are read.
  void Add(const PixelSample& sample);
  // Writes the folded node to its pixel in `tile`, whose range and feature end it has.
  void Store(TileStatistics* tile) const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace tessera
