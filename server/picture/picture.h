// The served picture of one job: planes resolved from its film, and the filtered picture, kept up
// to date tile by tile. Incremental equals from scratch, bit for bit: what a changed tile can reach
// (calibration radius + the filter's halo) is filtered again.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <shared_mutex>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "core/base/tile_grid.h"
#include "core/denoise/denoiser.h"
#include "core/film/frame_planes.h"
#include "core/image/image.h"
#include "tessera/v1/job.pb.h"

namespace tessera {

// Threads: Update from one thread at a time; the others from any.
class Picture {
 public:
  // `settings` are complete (CompleteSettings).
  explicit Picture(const v1::JobSettings& settings);

  // Gives the folded statistics of a tile as they are now.
  using TileSource = std::function<TileStatistics(int64_t tile)>;
  // Takes the tiles `changed` from `source` and filters all that they reach on num_threads.
  void Update(const std::vector<int64_t>& changed, const TileSource& source, int num_threads);

  // Grows with each Update.
  uint64_t version() const;
  // Differs between two pictures of a process.
  uint64_t serial() const { return serial_; }
  // Estimated sqrt(relMSE) of the filtered picture (DESIGN.md), from its own error output;
  // 0 = unknown. Deterministic.
  double estimated_error() const;
  // The named layers over `region`, which must lie in the job's region, as one consistent moment.
  // Errors: INVALID_ARGUMENT naming the layers that there are.
  absl::StatusOr<Image> Snapshot(const PixelRect& region,
                                 const std::vector<std::string>& layers) const;

 private:
  void Filter(const std::vector<int64_t>& changed, int num_threads);
  void EstimateError();

  const uint64_t serial_;
  const v1::JobSettings settings_;
  const TileGrid grid_;
  std::unique_ptr<Denoiser> denoiser_;  // constant after construction

  mutable std::shared_mutex mu_;  // guards what follows; Update's thread alone writes
  FramePlanes planes_;
  FilteredPlanes filtered_;
  uint64_t version_ = 0;
  double estimated_error_ = 0;

  FilteredPlanes scratch_;  // Update's own
};

// The rectangles that cover exactly the given tiles (ascending), touching tiles joined.
std::vector<PixelRect> JoinTiles(const TileGrid& grid, const std::vector<int64_t>& tiles);

}  // namespace tessera
