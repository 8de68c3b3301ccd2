// The server's checkpoints. Input: a file without its SHA-256, which is put right, as a disk with
// bad luck would.
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>

#include "core/base/sha256.h"
#include "server/store/film_store.h"
#include "tests/fuzz/fuzz_target.h"
#include "tests/server/synthetic_tile.h"

namespace tessera {
namespace {

constexpr uint64_t kJob = 1;
constexpr int64_t kFeatureEnd = 4;

// A store of this process in a folder that ends with it.
class Folder {
 public:
  Folder() {
    std::string pattern = (std::filesystem::temp_directory_path() / "tessera-fuzz-XXXXXX").string();
    path_ = mkdtemp(pattern.data());
    store_ = *FilmStore::Open(path_);
  }
  ~Folder() { std::filesystem::remove_all(path_); }
  FilmStore& store() { return *store_; }
  std::string file() const { return path_ + "/1.film"; }

 private:
  std::string path_;
  std::unique_ptr<FilmStore> store_;
};

Folder& TheFolder() {
  static Folder folder;
  return folder;
}

const TileGrid& TheGrid() {
  static const TileGrid grid({0, 0, 11, 9}, 8);
  return grid;
}

absl::StatusOr<StoredFilm> Load(std::string_view input) {
  {
    std::ofstream file(TheFolder().file(), std::ios::binary);
    file << input << ToBytes(Sha256Of(input));
  }
  return TheFolder().store().Load(kJob, TheGrid(), kFeatureEnd);
}

}  // namespace

bool IsTaken(std::string_view input) { return Load(input).ok(); }

void FuzzOne(std::string_view input) {
  const absl::StatusOr<StoredFilm> stored = Load(input);
  if (!stored.ok()) {
    if (stored.status().message().empty()) std::abort();
    return;
  }
  for (int64_t tile = 0; tile < TheGrid().num_tiles(); ++tile) {
    for (const TileStatistics& node : stored->film->Nodes(tile)) {
      if (node.window() != TheGrid().WindowOf(tile)) std::abort();
    }
  }
}

std::vector<std::string> FuzzSeeds() {
  std::vector<std::string> seeds;
  for (const int64_t spp : {1, 6, 16}) {
    const Film film = SyntheticFilm(3, TheGrid(), spp, kFeatureEnd);
    const absl::Status saved = TheFolder().store().Save(
        kJob, TheGrid().num_tiles(), [&](int64_t tile) -> FilmStorage::Tile {
          return {film.Nodes(tile), {.rays = 10, .delta_bytes = 3, .render_ns = 7}};
        });
    if (!saved.ok()) std::abort();
    std::ifstream file(TheFolder().file(), std::ios::binary);
    const std::string bytes(std::istreambuf_iterator<char>(file), {});
    seeds.push_back(bytes.substr(0, bytes.size() - std::tuple_size_v<Sha256Digest>));
  }
  return seeds;
}

}  // namespace tessera
