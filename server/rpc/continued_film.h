// The film that a job starts from: read from an uploaded film EXR, checked against the job, and cut
// into the job's tiles.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "core/film/film.h"
#include "core/image/film_file.h"
#include "tessera/v1/job.pb.h"

namespace tessera {

// Whether samples rendered with `film` are samples of `job`. Both are complete settings.
// Errors: INVALID_ARGUMENT naming the settings that differ.
absl::Status CheckSameSamples(const v1::JobSettings& film, const v1::JobSettings& job);

// For each tile of the job the samples [0, n) that all of its pixels have in the file. Samples
// beyond, of a file cut into other tiles, are left out: rendering them again gives the same bits.
std::shared_ptr<Film> CutFilm(const FilmFile& file, const TileGrid& grid);

// Reads the file at `path`; `version`: this program's, other versions may draw other bits (C2).
// No more memory is taken for its nodes than a film of the job's size can need, nor more than
// memory_max: its bytes are a stranger's.
// Errors: those; INVALID_ARGUMENT naming the film's version if it is another; as ReadFilmFile.
absl::StatusOr<std::shared_ptr<Film>> ReadContinuedFilm(const std::string& path,
                                                        const v1::JobSettings& job,
                                                        const std::string& version,
                                                        int64_t memory_max = INT64_MAX);

}  // namespace tessera
