#include "server/coordinator/sample_counts.h"

#include <algorithm>

#include "absl/strings/str_cat.h"

namespace tessera {

v1::SampleCounts CountsOf(const Film& film) {
  v1::SampleCounts counts;
  counts.set_tile_size(film.grid().tile_size());
  for (int64_t tile = 0; tile < film.grid().num_tiles(); ++tile) {
    const int64_t samples = film.CommittedEnd(tile);
    const int last = counts.run_samples_size() - 1;
    if (last >= 0 && counts.run_samples(last) == samples) {
      counts.set_run_tiles(last, counts.run_tiles(last) + 1);
    } else {
      counts.add_run_tiles(1);
      counts.add_run_samples(samples);
    }
  }
  if (counts.run_samples_size() <= 1) counts.Clear();
  return counts;
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
