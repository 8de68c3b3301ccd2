// Sample counts by tile, and their run-length coded form: what makes a picture whose tiles ended at
// different samples repeatable (C2).
#pragma once

#include <cstdint>
#include <vector>

#include "absl/status/status.h"
#include "core/film/film.h"
#include "tessera/v1/job.pb.h"

namespace tessera {

// The film's CommittedEnd of each tile. Empty if all are equal.
v1::SampleCounts CountsOf(const Film& film);
// Of any counts.
v1::SampleCounts CountsOf(const std::vector<int64_t>& samples_by_tile, int tile_size);

// Of all pixels of the grid's tiles together.
int64_t SamplesOf(const TileGrid& grid, const std::vector<int64_t>& samples_by_tile);

// Whether the counts give each of `num_tiles` tiles 0 to spp samples, and some tile one.
// Errors: INVALID_ARGUMENT naming the field.
absl::Status CheckCounts(const v1::SampleCounts& counts, int64_t num_tiles, int64_t spp);

// By tile. The counts have been checked.
std::vector<int64_t> ExpandCounts(const v1::SampleCounts& counts);

}  // namespace tessera
