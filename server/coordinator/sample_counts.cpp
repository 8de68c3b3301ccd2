#include "server/coordinator/sample_counts.h"

#include <algorithm>

#include "absl/strings/str_cat.h"

namespace tessera {

v1::SampleCounts CountsOf(const std::vector<int64_t>& samples_by_tile, int tile_size) {
  v1::SampleCounts counts;
  counts.set_tile_size(tile_size);
  for (const int64_t samples : samples_by_tile) {
    const int last = counts.run_samples_size() - 1;
    if (last >= 0 && counts.run_samples(last) == samples) {
      counts.set_run_tiles(last, counts.run_tiles(last) + 1);
    } else {
      counts.add_run_tiles(1);
      counts.add_run_samples(samples);
    }
  }
  return counts;
}

v1::SampleCounts CountsOf(const Film& film) {
  std::vector<int64_t> samples(static_cast<size_t>(film.grid().num_tiles()));
  for (int64_t tile = 0; tile < film.grid().num_tiles(); ++tile) {
    samples[static_cast<size_t>(tile)] = film.CommittedEnd(tile);
  }
  v1::SampleCounts counts = CountsOf(samples, film.grid().tile_size());
  if (counts.run_samples_size() <= 1) counts.Clear();
  return counts;
}

int64_t SamplesOf(const TileGrid& grid, const std::vector<int64_t>& samples_by_tile) {
  int64_t samples = 0;
  for (int64_t tile = 0; tile < grid.num_tiles(); ++tile) {
    samples += samples_by_tile[static_cast<size_t>(tile)] * grid.WindowOf(tile).area();
  }
  return samples;
}

absl::Status CheckCounts(const v1::SampleCounts& counts, int64_t num_tiles, int64_t spp) {
  int64_t tiles_left = num_tiles;
  int64_t samples_max = 0;
  bool possible = counts.run_tiles_size() == counts.run_samples_size();
  for (int run = 0; possible && run < counts.run_tiles_size(); ++run) {
    const int64_t samples = counts.run_samples(run);
    possible = counts.run_tiles(run) >= 1 && counts.run_tiles(run) <= tiles_left && samples >= 0 &&
               samples <= spp;
    tiles_left -= counts.run_tiles(run);
    samples_max = std::max(samples_max, samples);
  }
  if (possible && tiles_left == 0 && samples_max > 0) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("settings.replay: its counts must give each of ", num_tiles, " tiles 0 to ", spp,
                   " samples, and one of them at least 1"));
}

std::vector<int64_t> ExpandCounts(const v1::SampleCounts& counts) {
  std::vector<int64_t> by_tile;
  for (int run = 0; run < counts.run_tiles_size(); ++run) {
    by_tile.insert(by_tile.end(), static_cast<size_t>(counts.run_tiles(run)),
                   counts.run_samples(run));
  }
  return by_tile;
}

}  // namespace tessera
