// Pictures and films in files: `--continue`, `tessera denoise`, `tessera compare`, environments.
// Input: the file.
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>

#include "core/image/film_file.h"
#include "core/image/image_reader.h"
#include "tests/fuzz/fuzz_target.h"
#include "tests/server/synthetic_tile.h"
#include "tests/worker/scene/picture_bytes.h"

namespace tessera {
namespace {

constexpr ImageReadLimits kLimits{.pixels_max = 1 << 20, .values_max = 1 << 22};

// A file of this process that ends with it.
const std::string& ThePath() {
  static const struct Path {
    std::string name = (std::filesystem::temp_directory_path() / "tessera-fuzz-").string() +
                       std::to_string(getpid()) + ".exr";
    ~Path() { std::filesystem::remove(name); }
  } path;
  return path.name;
}

void Write(std::string_view input) { std::ofstream(ThePath(), std::ios::binary) << input; }

}  // namespace

bool IsTaken(std::string_view input) {
  Write(input);
  return ReadImage(ThePath(), kLimits).ok();
}

void FuzzOne(std::string_view input) {
  Write(input);
  const absl::StatusOr<Image> image = ReadImage(ThePath(), kLimits);
  if (!image.ok() && image.status().message().empty()) std::abort();
  const absl::StatusOr<FilmFile> film =
      ReadFilmFile(ThePath(), {.image = kLimits, .bytes_max = 1 << 24});
  if (!film.ok()) {
    if (film.status().message().empty()) std::abort();
    return;
  }
  for (const TileStatistics& node : film->nodes) {
    if (!film->region.Contains(node.window())) std::abort();
  }
}

std::vector<std::string> FuzzSeeds() {
  FilmFile film;
  film.settings = "{}";
  film.region = {0, 0, 8, 8};
  film.frame = film.region;
  film.nodes.push_back(SyntheticTile(1, film.region, {0, 4}));
  Image picture;
  picture.data_window = film.region;
  picture.display_window = film.frame;
  for (const char* name : {"R", "G", "B", "A"}) picture.Add(name, std::vector<float>(64, 0.5f));
  if (!WriteFilmFile(ThePath(), film, picture).ok()) std::abort();
  std::ifstream file(ThePath(), std::ios::binary);
  return {std::string(std::istreambuf_iterator<char>(file), {}), PictureBytes("exr", 4, 3, 3),
          PictureBytes("hdr", 9, 4, 3), PictureBytes("png", 5, 3, 4)};
}

}  // namespace tessera
