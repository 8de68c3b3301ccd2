// A film in an EXR file, beside the picture's own layers, so that any viewer opens it and a render
// can be continued from it. Lossless: every bit of every node comes back.
//
// Nodes of one sample range share a group of channels, `film.BEGIN-END.`:
//   node               which node the pixel belongs to, 1-based in the order of the file; 0 = no
//                      node of this range covers it
//   A.radiance.mean.R  and so on to B.votes: each plane of TileStatistics for each half; zero
//                      outside nodes. Ranges without features lack the planes of features.
// Metadata: film.version (2), film.settings (the caller's text), film.feature_spp (samples that
// carry features, 0 = all), film.non_finite ("NODE:COUNT,...", zeros left out).
#pragma once

#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/film/tile_statistics.h"
#include "core/image/image.h"
#include "core/image/image_reader.h"

namespace tessera {

struct FilmFile {
  std::string settings;                // what the film was rendered with; opaque here
  int64_t feature_end = kAllFeatures;  // of every node
  PixelRect region;                    // the data window
  PixelRect frame;                     // the display window
  std::vector<TileStatistics> nodes;   // ascending by range, then as they were written
  // The metadata `version` of the picture: of the program that rendered it; empty = unknown. Read,
  // not written.
  std::string version{};
};

// Different sample ranges in one file; a film that was cut short at any point has a few dozen.
inline constexpr int kFilmRangesMax = 1024;

// Writes `picture` (its layers and metadata) and the film, whole or not at all. Nodes lie inside
// picture.data_window; nodes of one range do not overlap; all end features at film.feature_end;
// film.region and film.frame are not read. Errors: INVALID_ARGUMENT for nodes that do not fit or
// too many ranges; as WriteExr.
absl::Status WriteFilmFile(const std::string& path, const FilmFile& film, const Image& picture);

struct FilmReadLimits {
  ImageReadLimits image = {.values_max = int64_t{1} << 32};
  // Memory that the nodes may take, and a band of rows beside them (of which 256 MiB are always
  // allowed). Compressed, a film of zeros is a thousandth of that.
  int64_t bytes_max = std::numeric_limits<int64_t>::max();
};

// Reads the film of `path`; its picture is read by ReadImage. What is beyond a limit is refused
// before memory is taken for it.
// Errors: FAILED_PRECONDITION  an image without a film: says how to write one
//         INVALID_ARGUMENT     damaged, inconsistent or beyond the limits; and as ReadImage
absl::StatusOr<FilmFile> ReadFilmFile(const std::string& path, const FilmReadLimits& limits = {});

}  // namespace tessera
