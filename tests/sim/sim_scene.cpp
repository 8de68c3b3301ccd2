#include "tests/sim/sim_scene.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <map>
#include <numeric>
#include <tuple>

#include "core/base/sha256.h"
#include "core/denoise/window_codec.h"
#include "core/film/delta_codec.h"
#include "server/coordinator/coordinator.h"
#include "server/coordinator/job_settings.h"
#include "server/coordinator/worker_message.h"
#include "tests/server/synthetic_tile.h"
#include "tests/sim/fault_plan.h"
#include "tests/sim/sim_random.h"
#include "worker/session/window_filter.h"

namespace tessera {

namespace {

// Processors of another arithmetic draw other bits.
uint64_t SeedOf(const v1::JobSettings& settings, int max_depth, const std::string& arithmetic) {
  return settings.seed() + 1000 * static_cast<uint64_t>(max_depth) +
         (arithmetic == kSimArithmetic ? 0 : 2000000);
}

}  // namespace

int SimDepth(const v1::JobSettings& settings, const std::string& arithmetic) {
  if (!settings.auto_depth()) return settings.max_depth();
  return static_cast<int>(settings.seed() % 3) + (arithmetic == kSimArithmetic ? 2 : 3);
}

v1::AssetRef SimAsset() {
  Sha256 hash;
  hash.Update(kSimAsset);
  v1::AssetRef asset;
  asset.set_name("scene.glb");
  asset.set_sha256(ToBytes(hash.Finish()));
  asset.set_size_bytes(sizeof(kSimAsset) - 1);
  return asset;
}

v1::TileDelta SimRender(const v1::JobSettings& settings, const v1::Lease& lease,
                        const std::string& arithmetic, int lie) {
  // A machine that miscalculates may find another depth, too.
  const bool is_depth_lie = settings.auto_depth() && lease.tile_index() % 2 == 0;
  const int max_depth = SimDepth(settings, arithmetic) + (is_depth_lie ? lie : 0);
  uint64_t seed = SeedOf(settings, max_depth, arithmetic);
  if (lie > 0) seed += 1000000 * static_cast<uint64_t>(2 * lie - 1);
  const PixelRect window = RectOf(lease.window());
  const SampleRange range{lease.sample_begin(), lease.sample_end()};
  const int64_t feature_end = FeatureEndOf(settings.feature_spp());
  // Few scenes are rendered by thousands of runs.
  using Key = std::tuple<uint64_t, int, int, int, int, int64_t, int64_t, int64_t>;
  static auto* const cache = new std::map<Key, EncodedDelta>();
  const Key key{seed, window.x_begin, window.y_begin, window.x_end,
                window.y_end,    range.begin,    range.end,      feature_end};
  auto rendered = cache->find(key);
  if (rendered == cache->end()) {
    const TileStatistics tile = SyntheticTile(seed, window, range, feature_end);
    rendered = cache->emplace(key, EncodeDelta(tile, DeltaEncoding::kPacked)).first;
  }
  const EncodedDelta& encoded = rendered->second;
  v1::TileDelta delta;
  delta.set_lease_id(lease.id());
  delta.set_job(lease.job());
  delta.set_tile_index(lease.tile_index());
  *delta.mutable_window() = lease.window();
  delta.set_sample_begin(range.begin);
  delta.set_sample_end(range.end);
  delta.set_feature_end(feature_end);
  delta.set_rays(range.size() * window.area());
  delta.set_max_depth(max_depth);
  delta.set_payload(encoded.payload);
  delta.set_encoding(static_cast<uint32_t>(encoded.encoding));
  delta.set_payload_bytes(encoded.payload_bytes);
  delta.set_checksum(DeltaChecksum(KeyOf(delta), delta.payload()));
  return delta;
}

std::string ReferenceDigest(const v1::JobSettings& settings, const std::vector<int64_t>& counts,
                            const std::string& arithmetic) {
  using Key = std::tuple<uint64_t, int, int, int, std::vector<int64_t>>;
  static auto* const cache = new std::map<Key, std::string>();
  const uint64_t seed = SeedOf(settings, SimDepth(settings, arithmetic), arithmetic);
  const Key key{seed, settings.width(), settings.height(), settings.tile_size(), counts};
  const auto known = cache->find(key);
  if (known != cache->end()) return known->second;
  Film film = EmptyFilmOf(settings);
  for (int64_t tile = 0; tile < film.grid().num_tiles(); ++tile) {
    for (const SampleRange& range : MaximalNodes({0, counts.at(static_cast<size_t>(tile))})) {
      (void)film.Accept(tile, SyntheticTile(seed, film.grid().WindowOf(tile), range,
                                            film.feature_end()));
    }
  }
  return cache->emplace(key, ToBytes(film.Digest())).first->second;
}

std::vector<double> SimTileErrors(const TileGrid& grid, const std::vector<int64_t>& samples) {
  std::vector<double> errors(samples.size());
  for (size_t tile = 0; tile < errors.size(); ++tile) {
    const double difficulty = 0.25 * static_cast<double>(1 + tile * 7 % 5);
    errors[tile] = 3 * difficulty / static_cast<double>(samples[tile]) *
                   static_cast<double>(grid.WindowOf(static_cast<int64_t>(tile)).area());
  }
  return errors;
}

double SimError(const TileGrid& grid, const std::vector<double>& tile_errors) {
  const double sum = std::accumulate(tile_errors.begin(), tile_errors.end(), 0.0);
  return std::sqrt(sum / (3 * static_cast<double>(grid.region().area())));
}

SimWindow MakeSimWindow(JobId job, uint64_t number) {
  const auto x = static_cast<int>(8 * (number % 16));
  const PixelRect frame{0, 0, 128, 16}, window = PixelRect::FromSize(x, 0, 8, 8);
  FramePlanes planes(window);
  SimRandom random(job * 1000 + number);
  for (size_t c = 0; c < 3; ++c) {
    for (size_t i = 0; i < planes.color[c].size(); ++i) {
      planes.color[c][i] = static_cast<float>(random.Uniform());
      planes.variance[c][i] = static_cast<float>(random.Uniform());
    }
  }
  std::ranges::fill(planes.samples, 4u);
  SimWindow made;
  made.lease.set_job(JobName(job));
  made.lease.set_denoiser("none");
  made.lease.set_quality(v1::QUALITY_FINAL);
  *made.lease.mutable_frame() = RegionProto(frame);
  *made.lease.mutable_window() = RegionProto(window);
  *made.lease.mutable_bounds() = RegionProto(window);
  made.lease.set_revision(number);
  made.input = EncodeFilterInput(planes, window);
  made.lease.set_input_bytes(std::ssize(made.input));
  made.lease.set_input_checksum(PayloadChecksum(made.input));
  made.filtered = FilteredPlanes(window);
  (*MakeDenoiser("none"))->Filter(planes, {frame, DenoiseQuality::kFinal}, window, &made.filtered);
  return made;
}

absl::StatusOr<v1::FilteredWindow> SimFilter(const v1::FilterLease& lease,
                                             const std::string& input, bool is_lie) {
  const std::atomic<bool> cancelled = false;
  std::atomic<int64_t> parts_done = 0;
  absl::StatusOr<v1::FilteredWindow> filtered =
      FilterWindow(lease, input, cancelled, &parts_done);
  if (!filtered.ok() || !is_lie) return filtered;
  FilteredPlanes planes = *DecodeFiltered(RectOf(lease.window()), filtered->payload());
  planes.color[1][3] += 0.5f;
  filtered->set_payload(EncodeFiltered(planes));
  filtered->set_checksum(
      FilteredChecksum({lease.id(), lease.job(), lease.revision(), RectOf(lease.window())},
                       filtered->payload()));
  return filtered;
}

}  // namespace tessera
