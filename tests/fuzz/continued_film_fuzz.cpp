// The film EXR that a job is to go on from, with the settings in its header. Input: the file.
#include <google/protobuf/util/json_util.h>

#include <cstdlib>

#include "server/coordinator/job_settings.h"
#include "server/rpc/continued_film.h"
#include "tests/fuzz/fuzz_file.h"
#include "tests/fuzz/fuzz_target.h"
#include "tests/server/simulated_farm.h"

namespace tessera {
namespace {

const v1::JobSettings& TheJob() {
  static const v1::JobSettings job = *CompleteSettings(SmallSettings(4), SmallConfig().defaults);
  return job;
}

const FuzzFile& TheFile() {
  static const FuzzFile file(".exr");
  return file;
}

absl::StatusOr<std::shared_ptr<Film>> Read(std::string_view input) {
  TheFile().Write(input);
  return ReadContinuedFilm(TheFile().path(), TheJob(), "1.2.3");
}

}  // namespace

bool IsTaken(std::string_view input) { return Read(input).ok(); }

void FuzzOne(std::string_view input) {
  const absl::StatusOr<std::shared_ptr<Film>> film = Read(input);
  if (!film.ok()) {
    if (film.status().message().empty()) std::abort();
    return;
  }
  const TileGrid grid(RegionOf(TheJob()), TheJob().tile_size());
  if (film->get()->grid().num_tiles() != grid.num_tiles()) std::abort();
  // A job can go on from it.
  SimulatedFarm farm;
  CreateJobEvent create{.settings = TheJob()};
  create.film = *film;
  farm.Post(std::move(create));
  farm.Connect();
  farm.RunAll();
}

std::vector<std::string> FuzzSeeds() {
  const TileGrid grid(RegionOf(TheJob()), TheJob().tile_size());
  const Film film = SyntheticFilm(1, grid, 2, FeatureEndOf(TheJob().feature_spp()));
  FilmFile file;
  file.feature_end = film.feature_end();
  file.region = file.frame = grid.region();
  if (!google::protobuf::util::MessageToJsonString(TheJob(), &file.settings).ok()) std::abort();
  for (int64_t tile = 0; tile < grid.num_tiles(); ++tile) {
    for (const TileStatistics& node : film.Nodes(tile)) file.nodes.push_back(node);
  }
  Image picture;
  picture.data_window = picture.display_window = grid.region();
  picture.Add("Z", std::vector<float>(static_cast<size_t>(grid.region().area())));
  picture.metadata["version"] = "1.2.3";
  if (!WriteFilmFile(TheFile().path(), file, picture).ok()) std::abort();
  return {TheFile().Read()};
}

}  // namespace tessera
