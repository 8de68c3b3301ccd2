#include "server/rpc/continued_film.h"

#include <algorithm>
#include <map>
#include <vector>

#include <google/protobuf/util/json_util.h>
#include <google/protobuf/util/message_differencer.h>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "core/base/check.h"
#include "server/coordinator/job_settings.h"

namespace tessera {
namespace {

using google::protobuf::util::MessageDifferencer;

// What the assets hold; the scene and the environment may have been renamed.
std::vector<std::string> AssetDigests(const v1::JobSettings& settings) {
  std::vector<std::string> digests;
  for (const v1::AssetRef& asset : settings.assets()) digests.push_back(asset.sha256());
  std::ranges::sort(digests);
  return digests;
}

v1::Environment WithoutName(v1::Environment environment) {
  if (environment.has_map_name()) environment.set_map_name("map");
  return environment;
}

void CopyPixels(const TileStatistics& from, const PixelRect& rect, TileStatistics* to) {
  const auto copy_plane = [&](const auto& source, const auto& target) {
    for (int y = rect.y_begin; y < rect.y_end; ++y) {
      std::copy_n(source.begin() + from.window().IndexOf(rect.x_begin, y), rect.width(),
                  target.begin() + to->window().IndexOf(rect.x_begin, y));
    }
  };
  for (int half = 0; half < kNumHalves; ++half) {
    for (int plane = 0; plane < from.num_float_planes(); ++plane) {
      copy_plane(from.Floats(half, plane), to->MutableFloats(half, plane));
    }
    for (int plane = 0; plane < from.num_count_planes(); ++plane) {
      copy_plane(from.Counts(half, plane), to->MutableCounts(half, plane));
    }
  }
}

// What the film of a job may take in memory, whoever wrote it: in every pixel a node for each power
// of two of samples, with features as far as the job has them.
FilmReadLimits LimitsOf(const v1::JobSettings& job) {
  const int64_t feature_end = FeatureEndOf(job.feature_spp());
  int64_t channels = 0;
  for (int64_t samples = 1; samples <= kSamplesMax; samples *= 2) {
    const int floats = samples <= feature_end ? kNumFloatPlanes : kNumRadiancePlanes;
    const int counts = samples <= feature_end ? kNumCountPlanes : kNumLaterCountPlanes;
    channels += 1 + kNumHalves * (floats + counts);
  }
  const int64_t area = RegionOf(job).area();
  return {.image = {.pixels_max = area, .values_max = area * kFilmRangesMax * 64},
          .bytes_max = area * channels * static_cast<int64_t>(sizeof(uint32_t))};
}

// Nodes of one tile under construction, by range; complete once every pixel has come.
struct Cut {
  TileStatistics statistics;
  int64_t pixels = 0;
};

}  // namespace

absl::Status CheckSameSamples(const v1::JobSettings& film, const v1::JobSettings& job) {
  std::vector<std::string> differences;
  const auto check = [&](bool same, const char* what) {
    if (!same) differences.push_back(what);
  };
  check(AssetDigests(film) == AssetDigests(job), "assets");
  check(MessageDifferencer::Equivalent(film.camera(), job.camera()), "camera");
  check(MessageDifferencer::Equivalent(WithoutName(film.environment()),
                                       WithoutName(job.environment())),
        "environment");
  check(film.width() == job.width() && film.height() == job.height(), "width, height");
  check(RegionOf(film) == RegionOf(job), "region");
  check(film.max_depth() == job.max_depth() && film.auto_depth() == job.auto_depth(),
        "max_depth");
  check(film.seed() == job.seed(), "seed");
  check(film.isa() == job.isa(), "isa");
  check(film.arithmetic() == job.arithmetic(), "arithmetic");
  check(film.feature_spp() == job.feature_spp(), "feature_spp");
  if (differences.empty()) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(
      "continue_film_sha256: the film was rendered with other settings: ",
      absl::StrJoin(differences, "; "), ": repeat the film's, or start without it"));
}

std::shared_ptr<Film> CutFilm(const FilmFile& file, const TileGrid& grid) {
  std::vector<std::map<SampleRange, Cut>> cuts(static_cast<size_t>(grid.num_tiles()));
  for (const TileStatistics& node : file.nodes) {
    int64_t non_finite = node.non_finite;
    for (const int64_t tile : grid.TilesIn(node.window())) {
      const PixelRect window = grid.WindowOf(tile);
      const PixelRect shared = window.Intersect(node.window());
      Cut& cut = cuts[static_cast<size_t>(tile)][node.range()];
      if (cut.pixels == 0) {
        cut.statistics = TileStatistics(window, node.range(), file.feature_end);
      }
      CopyPixels(node, shared, &cut.statistics);
      cut.pixels += shared.area();
      // Which of the node's pixels they were is not recorded: only the sum is kept.
      const int64_t here = std::min(non_finite, shared.area() * node.range().size());
      cut.statistics.non_finite += here;
      non_finite -= here;
    }
  }
  auto film = std::make_shared<Film>(grid, file.feature_end);
  for (int64_t tile = 0; tile < grid.num_tiles(); ++tile) {
    for (auto& [range, cut] : cuts[static_cast<size_t>(tile)]) {
      if (cut.pixels != grid.WindowOf(tile).area()) continue;
      if (range.begin != film->CommittedEnd(tile)) continue;
      TESSERA_CHECK(film->Accept(tile, std::move(cut.statistics)).ok());
    }
  }
  return film;
}

absl::StatusOr<std::shared_ptr<Film>> ReadContinuedFilm(const std::string& path,
                                                        const v1::JobSettings& job,
                                                        const std::string& version,
                                                        int64_t memory_max) {
  FilmReadLimits limits = LimitsOf(job);
  limits.bytes_max = std::min(limits.bytes_max, memory_max);
  const absl::StatusOr<FilmFile> file = ReadFilmFile(path, limits);
  if (!file.ok()) return file.status();
  if (file->version != version) {
    return absl::InvalidArgumentError(absl::StrCat(
        "continue_film_sha256: the film was rendered by ",
        file->version.empty() ? "an unknown version" : "version " + file->version.substr(0, 64),
        ", this is version ", version, ", which may draw other bits: continue it with the version "
        "that rendered it, or render anew"));
  }
  v1::JobSettings settings;
  const auto parsed = google::protobuf::util::JsonStringToMessage(file->settings, &settings);
  if (!parsed.ok() || settings.width() < 1) {
    return absl::InvalidArgumentError(
        "continue_film_sha256: the film's settings cannot be read: write it anew with --layers "
        "film");
  }
  if (absl::Status status = CheckSameSamples(settings, job); !status.ok()) return status;
  if (file->feature_end != FeatureEndOf(job.feature_spp())) {
    return absl::InvalidArgumentError(
        "continue_film_sha256: the film's planes and its settings disagree on feature_spp: write "
        "it anew with --layers film");
  }
  if (file->region != RegionOf(job)) {
    return absl::InvalidArgumentError("continue_film_sha256: the film shows another region");
  }
  return CutFilm(*file, TileGrid(RegionOf(job), job.tile_size()));
}

}  // namespace tessera
