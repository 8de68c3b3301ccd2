#include "client/cli/replay.h"

#include <algorithm>

#include <google/protobuf/util/json_util.h>

#include "absl/strings/str_cat.h"
#include "core/base/tile_grid.h"
#include "core/image/image_reader.h"

namespace tessera {
namespace {

constexpr int kTileSizeMax = 64;
constexpr size_t kTilesMax = size_t{1} << 18;  // that a server takes

std::string TextOf(const Metadata& metadata, const std::string& key) {
  const auto found = metadata.find(key);
  if (found == metadata.end()) return "";
  const std::string* text = std::get_if<std::string>(&found->second);
  return text == nullptr ? "" : *text;
}

PixelRect RegionOf(const v1::JobSettings& settings) {
  if (!settings.has_region()) return PixelRect::FromSize(0, 0, settings.width(), settings.height());
  const v1::Region& r = settings.region();
  return PixelRect::FromSize(r.x(), r.y(), r.width(), r.height());
}

// The count of each tile, or none if a tile has pixels with different ones.
std::vector<int64_t> CountsByTile(const ReplayedPicture& picture, int tile_size) {
  const TileGrid grid(picture.region, tile_size);
  std::vector<int64_t> counts;
  for (int64_t tile = 0; tile < grid.num_tiles(); ++tile) {
    const PixelRect window = grid.WindowOf(tile);
    const auto at = [&](int x, int y) {
      return picture.samples[static_cast<size_t>(picture.region.IndexOf(x, y))];
    };
    const uint32_t count = at(window.x_begin, window.y_begin);
    for (int y = window.y_begin; y < window.y_end; ++y) {
      for (int x = window.x_begin; x < window.x_end; ++x) {
        if (at(x, y) != count) return {};
      }
    }
    counts.push_back(count);
  }
  return counts;
}

// All tile sizes, those nearest to `wanted` by ratio first.
std::vector<int> TileSizesNear(int wanted) {
  std::vector<int> sizes;
  for (int size = 1; size <= kTileSizeMax; ++size) sizes.push_back(size);
  const auto ratio = [wanted](int size) {
    return static_cast<double>(std::max(size, wanted)) / std::min(size, wanted);
  };
  std::ranges::stable_sort(sizes, {}, ratio);
  return sizes;
}

}  // namespace

absl::StatusOr<ReplayedPicture> ReadReplayedPicture(const std::string& path) {
  absl::StatusOr<Image> image = ReadUintChannel(path, "samples");
  if (absl::IsFailedPrecondition(image.status())) {
    return absl::FailedPreconditionError(
        absl::StrCat("--replay ", path, ": has no layer 'samples': give an EXR that tessera wrote "
                     "with all layers (--layers all or film)"));
  }
  if (!image.ok()) {
    return absl::Status(image.status().code(),
                        absl::StrCat("--replay: ", image.status().message()));
  }
  ReplayedPicture picture;
  picture.version = TextOf(image->metadata, "version");
  picture.digest = TextOf(image->metadata, "digest");
  const auto parsed = google::protobuf::util::JsonStringToMessage(
      TextOf(image->metadata, "settings"), &picture.settings);
  if (!parsed.ok() || picture.settings.scene_name().empty() || picture.version.empty() ||
      picture.settings.tile_size() < 1) {
    return absl::InvalidArgumentError(
        absl::StrCat("--replay ", path, ": does not say how it was rendered: give an EXR that "
                     "'tessera render' or 'tessera fetch' wrote"));
  }
  picture.region = image->data_window;
  if (picture.region != RegionOf(picture.settings)) {
    return absl::InvalidArgumentError(
        absl::StrCat("--replay ", path, ": shows only a part of what was rendered: give the whole "
                     "picture, without fetch's --region"));
  }
  picture.samples = std::move(image->channels.front().uints);
  return picture;
}

absl::Status SetReplay(const ReplayedPicture& picture, v1::JobSettings* settings) {
  const uint32_t samples_max = *std::ranges::max_element(picture.samples);
  if (samples_max == 0) {
    return absl::InvalidArgumentError(
        "--replay: the picture has no samples: there is nothing to repeat");
  }
  settings->set_spp(samples_max);
  settings->clear_target_error();
  settings->clear_target_tile_error();
  settings->clear_sampling();
  settings->clear_max_time();
  std::vector<int64_t> counts;
  for (const int size : TileSizesNear(std::clamp(settings->tile_size(), 1, kTileSizeMax))) {
    counts = CountsByTile(picture, size);
    if (counts.size() > kTilesMax) counts.clear();
    if (counts.empty()) continue;
    settings->set_tile_size(size);
    break;
  }
  if (counts.empty()) {  // those that it was rendered with would fit
    return absl::InvalidArgumentError(
        absl::StrCat("--replay: the layer 'samples' differs from pixel to pixel in a way that no "
                     "tiles do, of which a server takes ", kTilesMax, ": the file was edited after "
                     "it was rendered; give the one that tessera wrote"));
  }
  v1::Replay& replay = *settings->mutable_replay();
  replay.Clear();
  replay.set_version(picture.version);
  v1::SampleCounts& runs = *replay.mutable_counts();
  runs.set_tile_size(settings->tile_size());
  for (const int64_t count : counts) {
    const int last = runs.run_samples_size() - 1;
    if (last >= 0 && runs.run_samples(last) == count) {
      runs.set_run_tiles(last, runs.run_tiles(last) + 1);
    } else {
      runs.add_run_tiles(1);
      runs.add_run_samples(count);
    }
  }
  return absl::OkStatus();
}

}  // namespace tessera
