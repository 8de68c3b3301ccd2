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

  // Begins a node; `range.IsNode()`.
  void Begin(SampleRange range);
  // The next sample, in ascending order; range.size() calls in all. The sample must be finite
  // (ReplaceNonFinite).
  void Add(const PixelSample& sample);
  // Writes the folded node to the pixel (x, y) of `tile`, whose range is the node.
  void Store(int x, int y, TileStatistics* tile) const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace tessera
