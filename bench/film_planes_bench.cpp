// How many bytes a pixel of a film are planes that are constant: one value over all pixels of their
// tile. One row a film, as `tessera render --layers film --tile-size N` writes it.
//   film_planes_bench FILM.exr...
#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "core/image/film_file.h"

namespace tessera {
namespace {

enum Column : int { kRadiance, kAlbedo, kNormal, kDepth, kCounts, kNumColumns };

Column ColumnOf(int float_plane) {
  if (float_plane < kAlbedoMean) return kRadiance;
  if (float_plane < kNormalMean) return kAlbedo;
  return float_plane < kDepthMean ? kNormal : kDepth;
}

struct Bytes {
  int64_t all = 0, zero = 0;
  std::array<int64_t, kNumColumns> constant = {};
};

template <typename T>
void AddPlane(std::span<const T> plane, Column column, Bytes* bytes) {
  const auto size = static_cast<int64_t>(plane.size_bytes());
  const auto first = std::bit_cast<uint32_t>(plane[0]);
  bytes->all += size;
  if (!std::ranges::all_of(plane, [&](T v) { return std::bit_cast<uint32_t>(v) == first; })) return;
  bytes->constant[column] += size;
  if (first == 0) bytes->zero += size;
}

Bytes BytesOf(const FilmFile& film) {
  Bytes bytes;
  for (const TileStatistics& node : film.nodes) {
    for (int half = 0; half < kNumHalves; ++half) {
      for (int plane = 0; plane < node.num_float_planes(); ++plane) {
        AddPlane(node.Floats(half, plane), ColumnOf(plane), &bytes);
      }
      for (int plane = 0; plane < node.num_count_planes(); ++plane) {
        AddPlane(node.Counts(half, plane), kCounts, &bytes);
      }
    }
  }
  return bytes;
}

// The share that is not constant.
double Print(const std::string& name, const Bytes& bytes, int64_t num_pixels) {
  const auto per_pixel = [&](int64_t count) {
    return static_cast<double>(count) / static_cast<double>(num_pixels);
  };
  int64_t constant = 0;
  for (const int64_t count : bytes.constant) constant += count;
  const double left = static_cast<double>(bytes.all - constant) / static_cast<double>(bytes.all);
  std::printf("| %s | %.1f |", name.c_str(), per_pixel(bytes.all));
  for (const int64_t count : bytes.constant) std::printf(" %.1f |", per_pixel(count));
  std::printf(" %.1f | %.1f | %.2f |\n", per_pixel(constant), per_pixel(bytes.zero), left);
  return left;
}

int Run(const std::vector<std::string>& paths) {
  std::printf(
      "| film | all | radiance | albedo | normal | depth | counts | constant | of it zero "
      "| left |\n|---|---|---|---|---|---|---|---|---|---|\n");
  double logs = 0;
  for (const std::string& path : paths) {
    const auto film = ReadFilmFile(path);
    if (!film.ok()) {
      std::fprintf(stderr, "%s: %s\n", path.c_str(), film.status().ToString().c_str());
      return 1;
    }
    int64_t num_pixels = 0;
    for (const TileStatistics& node : film->nodes) {
      if (node.range().begin == 0) num_pixels += node.num_pixels();
    }
    logs += std::log(Print(std::filesystem::path(path).stem(), BytesOf(*film), num_pixels));
  }
  std::printf("| geometric mean | | | | | | | | | %.2f |\n",
              std::exp(logs / static_cast<double>(paths.size())));
  return 0;
}

}  // namespace
}  // namespace tessera

int main(int argc, char** argv) {
  std::vector<std::string> paths;
  CLI::App app("Bytes a pixel of a film's constant planes");
  app.add_option("films", paths)->required();
  CLI11_PARSE(app, argc, argv);
  return tessera::Run(paths);
}
