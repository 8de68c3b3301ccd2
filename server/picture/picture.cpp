#include "server/picture/picture.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <mutex>
#include <set>

#include "absl/strings/str_cat.h"
#include "core/base/check.h"
#include "core/denoise/denoise_frame.h"
#include "core/image/layers.h"
#include "core/statistics/calibration.h"
#include "server/coordinator/job_settings.h"

namespace tessera {
namespace {

// The half-width of a 95 % interval is this many standard deviations.
constexpr double kHalfWidthSigmas = 1.959964;
constexpr double kRelMseEpsilon = 0.01;  // DESIGN.md, definitions
constexpr double kLeastError = 1e-12;    // what stands for none, as 0 means unknown

uint64_t NextSerial() {
  static std::atomic<uint64_t> last{0};
  return ++last;
}

std::vector<int64_t> Reached(const TileGrid& grid, const std::vector<int64_t>& tiles,
                             int border_px) {
  std::set<int64_t> reached;
  for (const int64_t tile : tiles) {
    for (const int64_t other : grid.TilesIn(grid.WindowOf(tile).Expand(border_px))) {
      reached.insert(other);
    }
  }
  return {reached.begin(), reached.end()};
}

void CopyWindow(const FilteredPlanes& from, const PixelRect& window, FilteredPlanes* to) {
  for (int channel = 0; channel < 3; ++channel) {
    const auto c = static_cast<size_t>(channel);
    for (int y = window.y_begin; y < window.y_end; ++y) {
      const int64_t source = from.bounds.IndexOf(window.x_begin, y);
      const int64_t target = to->bounds.IndexOf(window.x_begin, y);
      std::copy_n(from.color[c].begin() + source, window.width(), to->color[c].begin() + target);
      std::copy_n(from.error[c].begin() + source, window.width(), to->error[c].begin() + target);
    }
  }
}

}  // namespace

std::vector<PixelRect> JoinTiles(const TileGrid& grid, const std::vector<int64_t>& tiles) {
  std::vector<PixelRect> rects;
  for (size_t i = 0; i < tiles.size();) {
    // A run of tiles in one row.
    PixelRect run = grid.WindowOf(tiles[i]);
    size_t next = i + 1;
    while (next < tiles.size() && tiles[next] == tiles[next - 1] + 1 &&
           tiles[next] % grid.num_columns() != 0) {
      run.x_end = grid.WindowOf(tiles[next]).x_end;
      ++next;
    }
    i = next;
    // The same run in the row above grows downward.
    const auto above = std::ranges::find_if(rects, [&](const PixelRect& r) {
      return r.y_end == run.y_begin && r.x_begin == run.x_begin && r.x_end == run.x_end;
    });
    if (above != rects.end()) {
      above->y_end = run.y_end;
    } else {
      rects.push_back(run);
    }
  }
  return rects;
}

Picture::Picture(const v1::JobSettings& settings)
    : serial_(NextSerial()),
      settings_(settings),
      grid_(RegionOf(settings), settings.tile_size()),
      planes_(grid_.region()),
      filtered_(grid_.region()),
      scratch_(grid_.region()) {
  absl::StatusOr<std::unique_ptr<Denoiser>> denoiser = MakeDenoiser(settings.denoiser());
  TESSERA_CHECK(denoiser.ok());
  denoiser_ = *std::move(denoiser);
}

void Picture::Update(const std::vector<int64_t>& changed, const TileSource& source,
                     int num_threads) {
  for (const int64_t tile : changed) {
    const TileStatistics statistics = source(tile);
    std::unique_lock lock(mu_);
    planes_.Resolve(statistics);
  }
  Filter(changed, num_threads);
}

void Picture::Filter(const std::vector<int64_t>& changed, int num_threads) {
  {
    std::unique_lock lock(mu_);
    const std::vector<int64_t> reached = Reached(grid_, changed, kCalibrationRadiusPx);
    for (const PixelRect& window : JoinTiles(grid_, reached)) CalibrateVariance(window, &planes_);
  }
  const std::vector<PixelRect> windows =
      JoinTiles(grid_, Reached(grid_, changed, kCalibrationRadiusPx + denoiser_->halo_px()));
  const FrameParameters parameters{
      .frame = grid_.region(),
      .quality = settings_.quality() == v1::QUALITY_PREVIEW ? DenoiseQuality::kPreview
                                                            : DenoiseQuality::kFinal};
  DenoiseWindows(*denoiser_, planes_, parameters, windows, num_threads, &scratch_);
  std::unique_lock lock(mu_);
  for (const PixelRect& window : windows) CopyWindow(scratch_, window, &filtered_);
  EstimateError();
  ++version_;
}

void Picture::EstimateError() {
  double sum = 0;
  const size_t num_pixels = filtered_.color[0].size();
  for (size_t c = 0; c < 3; ++c) {
    for (size_t i = 0; i < num_pixels; ++i) {
      const double sigma = double{filtered_.error[c][i]} / kHalfWidthSigmas;
      const double value = filtered_.color[c][i];
      sum += sigma * sigma / (value * value + kRelMseEpsilon);
    }
  }
  const double error = std::sqrt(sum / (3.0 * static_cast<double>(num_pixels)));
  estimated_error_ = std::isfinite(error) ? std::max(error, kLeastError) : 0;
}

uint64_t Picture::version() const {
  std::shared_lock lock(mu_);
  return version_;
}

double Picture::estimated_error() const {
  std::shared_lock lock(mu_);
  return estimated_error_;
}

absl::StatusOr<Image> Picture::Snapshot(const PixelRect& region,
                                        const std::vector<std::string>& layers) const {
  if (region.empty() || !grid_.region().Contains(region)) {
    const PixelRect& all = grid_.region();
    return absl::InvalidArgumentError(absl::StrCat(
        "region is not inside what the job renders: ", all.x_begin, ",", all.y_begin, ",",
        all.width(), ",", all.height()));
  }
  Image image;
  image.data_window = region;
  image.display_window = PixelRect::FromSize(0, 0, settings_.width(), settings_.height());
  std::shared_lock lock(mu_);
  for (const std::string& name : layers) {
    const PictureLayer* const layer = FindPictureLayer(name);
    if (layer == nullptr) {
      std::string names;
      for (const PictureLayer& known : PictureLayers()) {
        names += (names.empty() ? "" : ", ") + std::string(known.name);
      }
      return absl::InvalidArgumentError(
          absl::StrCat("layer '", name.substr(0, 64), "' is unknown: give one of ", names));
    }
    AddPictureLayer(*layer, planes_, filtered_, settings_.transparent(), &image);
  }
  return image;
}

}  // namespace tessera
