#include "client/cli/denoise_input.h"

#include <array>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/cli/film_settings.h"
#include "core/film/film.h"
#include "core/image/image_reader.h"

namespace tessera {
namespace {

constexpr int kTileSizeMax = 1 << 16;

absl::StatusOr<DenoiseInput> ReadFilm(const std::string& path) {
  absl::StatusOr<FilmFile> file = ReadFilmFile(path);
  if (!file.ok()) return file.status();
  const absl::StatusOr<v1::JobSettings> settings = SettingsOfFilm(*file, path);
  if (!settings.ok()) return settings.status();
  if (settings->tile_size() > kTileSizeMax) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": its tile size is impossible"));
  }
  const TileGrid grid(file->region, settings->tile_size());
  Film film(grid, file->feature_end);
  for (const TileStatistics& node : file->nodes) {
    const int column = (node.window().x_begin - file->region.x_begin) / grid.tile_size();
    const int row = (node.window().y_begin - file->region.y_begin) / grid.tile_size();
    const absl::Status accepted = film.Accept(int64_t{row} * grid.num_columns() + column, node);
    if (!accepted.ok() && !absl::IsAlreadyExists(accepted)) {
      return absl::Status(accepted.code(), absl::StrCat(path, ": ", accepted.message()));
    }
  }
  DenoiseInput input;
  input.planes = FramePlanes(file->region);
  for (int64_t tile = 0; tile < grid.num_tiles(); ++tile) input.planes.Resolve(film.Fold(tile));
  input.frame = file->frame;
  input.transparent = settings->transparent();
  input.metadata["settings"] = file->settings;
  input.film = *std::move(file);
  return input;
}

// The mean of two channels and the variance of that mean, estimated from the two alone.
void JoinChannels(const ImageChannel& a, const ImageChannel& b, Plane* mean, Plane* variance) {
  for (size_t i = 0; i < mean->size(); ++i) {
    const float difference = a.floats[i] - b.floats[i];
    (*mean)[i] = (a.floats[i] + b.floats[i]) / 2;
    (*variance)[i] = difference * difference / 4;
  }
}

// Whether both pictures have the float channel; then `a` and `b` are set.
bool FindBoth(const std::array<Image, 2>& halves, const std::string& channel,
              const ImageChannel** a, const ImageChannel** b) {
  *a = halves[0].Find(channel);
  *b = halves[1].Find(channel);
  return *a != nullptr && *b != nullptr && !(*a)->is_uint && !(*b)->is_uint;
}

absl::Status CheckFinite(const std::string& path, const Image& image) {
  for (const ImageChannel& channel : image.channels) {
    for (const float value : channel.floats) {
      if (!std::isfinite(value) && channel.name.size() == 1) {
        return absl::InvalidArgumentError(absl::StrCat(
            path, ": channel ", channel.name, " has values that are not finite: render it again"));
      }
    }
  }
  return absl::OkStatus();
}

absl::StatusOr<DenoiseInput> ReadHalves(const std::vector<std::string>& paths) {
  std::array<Image, 2> halves;
  for (size_t half = 0; half < 2; ++half) {
    absl::StatusOr<Image> image = ReadImage(paths[half]);
    if (!image.ok()) return image.status();
    const absl::Status finite = CheckFinite(paths[half], *image);
    if (!finite.ok()) return finite;
    halves[half] = *std::move(image);
  }
  if (halves[0].data_window != halves[1].data_window) {
    return absl::InvalidArgumentError(
        absl::StrCat(paths[1], ": covers other pixels than ", paths[0],
                     ": give two halves of one frame"));
  }
  DenoiseInput input;
  input.frame = halves[0].display_window;
  input.planes = FramePlanes(halves[0].data_window);
  FramePlanes& planes = input.planes;
  const ImageChannel* a = nullptr;
  const ImageChannel* b = nullptr;
  const std::array<std::string, 3> rgb = {"R", "G", "B"};
  const std::array<std::string, 3> xyz = {"X", "Y", "Z"};
  for (size_t c = 0; c < 3; ++c) {
    if (!FindBoth(halves, rgb[c], &a, &b)) {
      return absl::InvalidArgumentError(absl::StrCat(
          paths[0], ", ", paths[1], ": have no channel ", rgb[c], " in common: both need R, G, B"));
    }
    planes.color_half[0][c] = a->floats;
    planes.color_half[1][c] = b->floats;
    JoinChannels(*a, *b, &planes.color[c], &planes.sample_variance_of_mean[c]);
    if (FindBoth(halves, "albedo." + rgb[c], &a, &b)) {
      JoinChannels(*a, *b, &planes.albedo[c], &planes.albedo_variance[c]);
    }
    if (FindBoth(halves, "normal." + xyz[c], &a, &b)) {
      JoinChannels(*a, *b, &planes.normal[c], &planes.normal_variance[c]);
    }
  }
  if (FindBoth(halves, "Z", &a, &b)) JoinChannels(*a, *b, &planes.depth, &planes.depth_variance);
  // One "sample" a half: what the variance needs to know is that both have equally many.
  planes.samples.assign(planes.samples.size(), 2);
  planes.coverage.assign(planes.coverage.size(), 1.0f);
  return input;
}

}  // namespace

absl::StatusOr<DenoiseInput> ReadDenoiseInput(const std::vector<std::string>& paths) {
  return paths.size() == 1 ? ReadFilm(paths.front()) : ReadHalves(paths);
}

}  // namespace tessera
