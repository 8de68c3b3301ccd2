#include "server/picture/picture.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <iterator>
#include <limits>
#include <mutex>
#include <set>

#include "absl/strings/str_cat.h"
#include "core/base/check.h"
#include "core/base/tile_grid.h"
#include "core/image/layers.h"
#include "core/statistics/calibration.h"
#include "server/coordinator/job_settings.h"
#include "server/picture/parallel.h"
#include "server/picture/settled.h"

namespace tessera {
namespace {

constexpr double kLeastError = 1e-12;  // what stands for none, as 0 means unknown
constexpr int kResolvedPartPx = 128;   // of a unit of work without a large halo
constexpr float kUnknown = std::numeric_limits<float>::infinity();

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

Picture::Picture(const v1::JobSettings& settings, bool spares_settled)
    : serial_(NextSerial()),
      settings_(settings),
      quality_(settings.quality() == v1::QUALITY_PREVIEW ? DenoiseQuality::kPreview
                                                         : DenoiseQuality::kFinal),
      spares_settled_(spares_settled),
      grid_(RegionOf(settings), settings.tile_size()),
      planes_(grid_.region()),
      filtered_(grid_.region()),
      shown_(static_cast<size_t>(grid_.num_tiles())),
      row_errors_(static_cast<size_t>(grid_.region().height())) {
  absl::StatusOr<std::unique_ptr<Denoiser>> denoiser = MakeDenoiser(settings.denoiser());
  TESSERA_CHECK(denoiser.ok());
  denoiser_ = *std::move(denoiser);
  filter_ = denoiser_->MakeFrameFilter({grid_.region(), quality_}, grid_.region());
  preview_filter_ =
      denoiser_->MakeFrameFilter({grid_.region(), DenoiseQuality::kPreview}, grid_.region());
  // What is not sampled yet is unknown.
  for (Planes3* const planes :
       {&planes_.sample_variance_of_mean, &planes_.variance, &planes_.albedo_variance,
        &planes_.normal_variance, &filtered_.error}) {
    for (Plane& plane : *planes) std::ranges::fill(plane, kUnknown);
  }
  std::ranges::fill(planes_.depth_variance, kUnknown);
  std::ranges::fill(filtered_.relative_error, kUnknown);
}

double Picture::Update(const std::vector<int64_t>& changed, const TileSource& source,
                       DenoiseQuality quality, int num_threads, const Views& views) {
  if (quality == DenoiseQuality::kFinal) {
    return Absorb(changed, source, num_threads) +
           Refine(std::numeric_limits<int64_t>::max(), num_threads, nullptr, views);
  }
  double cpu_seconds = changed.empty() ? 0 : TakeTiles(changed, source, num_threads);
  std::vector<int64_t> seen;
  for (auto it = rough_.begin(); it != rough_.end();) {
    auto& [tile, rough] = *it;
    const PixelRect window = grid_.WindowOf(tile);
    if (!rough.is_stale || !views.Meets(window)) {
      ++it;
      continue;
    }
    if (MaySpare(tile)) {
      rough.is_stale = false;  // until more news reach it; Refine takes them in
      ++num_spared_;
      ++it;
      continue;
    }
    seen.push_back(tile);
    rough = {window};  // the preview takes whole tiles
    it = quality == quality_ ? rough_.erase(it) : std::next(it);
  }
  if (!seen.empty()) cpu_seconds += FilterWindows(JoinTiles(grid_, seen), quality, num_threads);
  std::unique_lock lock(mu_);
  NoteShownLocked(views);
  is_refined_ = IsWholeLocked(nullptr);
  if (!seen.empty() || !changed.empty()) ++version_;
  return cpu_seconds;
}

bool Picture::MaySpare(int64_t tile) const {
  return spares_settled_ && shown_[static_cast<size_t>(tile)] != 0 &&
         IsSettled(planes_, filtered_, grid_.WindowOf(tile));
}

double Picture::Absorb(const std::vector<int64_t>& changed, const TileSource& source,
                       int num_threads) {
  const double cpu_seconds = changed.empty() ? 0 : TakeTiles(changed, source, num_threads);
  std::unique_lock lock(mu_);
  is_refined_ = false;
  return cpu_seconds;
}

double Picture::Refine(int64_t pixels_max, int num_threads, LeasedWindows* leased,
                       const Views& views, const Views& first) {
  DropDistrusted();
  double cpu_seconds = 0;
  bool has_news = false;
  if (leased != nullptr) {
    std::vector<LeasedWindows::Answer> answers = leased->Take();
    has_news = !answers.empty();
    cpu_seconds += TakeAnswers(std::move(answers), num_threads, *leased);
  }
  Slice slice;
  TakeSlice(first, pixels_max, &slice);
  if (leased != nullptr && views.is_whole()) {
    cpu_seconds += LeaseWindows(pixels_max, num_threads, *leased);
    if (rough_.empty() && slice.pixels == 0) AwaitLeased(num_threads, *leased);
  }
  TakeSlice(views, pixels_max, &slice);
  if (slice.pixels > 0) {
    std::ranges::sort(slice.whole_tiles);
    std::ranges::copy(JoinTiles(grid_, slice.whole_tiles), std::back_inserter(slice.windows));
    const double own_seconds = FilterWindows(slice.windows, quality_, num_threads);
    if (leased != nullptr) leased->NoteOwnSpeed(slice.pixels, own_seconds);
    cpu_seconds += own_seconds;
  }
  std::unique_lock lock(mu_);
  for (const int64_t tile : slice.tiles) shown_[static_cast<size_t>(tile)] = 1;
  if (IsRefinedLocked(views, leased)) NoteShownLocked(views);
  is_refined_ = IsWholeLocked(leased);
  if (slice.pixels > 0 || has_news || is_refined_) ++version_;  // else it waits for workers
  return cpu_seconds;
}

void Picture::TakeSlice(const Views& views, int64_t pixels_max, Slice* slice) {
  for (auto it = rough_.begin(); it != rough_.end() && slice->pixels < pixels_max;) {
    const auto& [tile, rough] = *it;
    const PixelRect window = grid_.WindowOf(tile);
    if (!views.Meets(window)) {
      ++it;
      continue;
    }
    slice->pixels += rough.part.area();
    slice->tiles.push_back(tile);
    rough.part == window ? slice->whole_tiles.push_back(tile)
                         : slice->windows.push_back(rough.part);
    it = rough_.erase(it);
  }
}

bool Picture::IsRefined(const Views& views, const LeasedWindows* leased) const {
  std::shared_lock lock(mu_);
  return IsRefinedLocked(views, leased);
}

bool Picture::IsRefinedLocked(const Views& views, const LeasedWindows* leased) const {
  if (views.is_whole()) return IsWholeLocked(leased);
  if (is_distrusted_ || (leased != nullptr && leased->Meets(views))) return false;
  return std::ranges::none_of(
      rough_, [&](const auto& rough) { return views.Meets(grid_.WindowOf(rough.first)); });
}

void Picture::NoteShownLocked(const Views& views) {
  for (int64_t tile = 0; tile < grid_.num_tiles(); ++tile) {
    if (views.Meets(grid_.WindowOf(tile))) shown_[static_cast<size_t>(tile)] = 1;
  }
}

bool Picture::HasShown(const std::optional<PixelRect>& region) const {
  std::shared_lock lock(mu_);
  return std::ranges::all_of(grid_.TilesIn(region.value_or(grid_.region())),
                             [&](int64_t tile) { return shown_[static_cast<size_t>(tile)] != 0; });
}

// A tile that meets `views` is filtered whole, so what reaches it from there counts.
bool Picture::Reaches(int64_t tile, const Views& views, DenoiseQuality quality) const {
  const FrameFilter& filter = quality == quality_ ? *filter_ : *preview_filter_;
  return views.Meets(grid_.WindowOf(tile).Expand(filter.reach_px() + grid_.tile_size()));
}

double Picture::TakeTiles(const std::vector<int64_t>& changed, const TileSource& source,
                          int num_threads) {
  std::vector<int64_t> resolved;
  double cpu_seconds = Resolve(changed, source, num_threads, &resolved);
  const std::vector<int64_t> reached = Reached(grid_, resolved, kCalibrationRadiusPx);
  const std::vector<PixelRect> moved = SplitWindows(JoinTiles(grid_, reached), kResolvedPartPx);
  {
    std::unique_lock lock(variance_mu_);
    cpu_seconds += ParallelFor(moved.size(), num_threads,
                               [&](size_t i) { CalibrateVariance(moved[i], &planes_); });
  }
  ++revision_;
  for (const int64_t tile : resolved) {
    filter_->Invalidate(grid_.WindowOf(tile));
    preview_filter_->Invalidate(grid_.WindowOf(tile));
  }
  LeaveToRefine(StalePixels(resolved, quality_));
  for (const auto& [tile, part] : StalePixels(resolved, DenoiseQuality::kPreview)) {
    if (const auto it = rough_.find(tile); it != rough_.end()) it->second.is_stale = true;
  }
  return cpu_seconds;
}

std::map<int64_t, PixelRect> Picture::StalePixels(const std::vector<int64_t>& tiles,
                                                  DenoiseQuality quality) const {
  const FrameFilter& filter = quality == quality_ ? *filter_ : *preview_filter_;
  std::map<int64_t, PixelRect> stale;
  for (const int64_t tile : tiles) {
    const PixelRect news = grid_.WindowOf(tile).Expand(filter.reach_px());
    for (const int64_t other : grid_.TilesIn(news)) {
      const PixelRect part = news.Intersect(grid_.WindowOf(other));
      const auto [it, is_new] = stale.try_emplace(other, part);
      if (!is_new) it->second = Around(it->second, part);
    }
  }
  return stale;
}

void Picture::LeaveToRefine(const std::map<int64_t, PixelRect>& stale) {
  for (const auto& [tile, part] : stale) {
    const auto [it, is_new] = rough_.try_emplace(tile, Rough{part});
    if (!is_new) it->second.part = Around(it->second.part, part);
  }
}

bool Picture::IsWholeLocked(const LeasedWindows* leased) const {
  return rough_.empty() && !is_distrusted_ && (leased == nullptr || leased->empty());
}

void Picture::LeaveWindowToRefine(const PixelRect& window) {
  for (const int64_t tile : grid_.TilesIn(window)) {
    LeaveToRefine({{tile, window.Intersect(grid_.WindowOf(tile))}});
  }
}

double Picture::FilterWindows(const std::vector<PixelRect>& windows, DenoiseQuality quality,
                              int num_threads) {
  return Filter(windows, quality, num_threads) + JudgeWindows(windows, num_threads);
}

double Picture::JudgeWindows(const std::vector<PixelRect>& windows, int num_threads) {
  const double cpu_seconds = SumErrors(windows, num_threads);
  const double error = EstimateError();
  std::unique_lock lock(mu_);
  estimated_error_ = error;
  return cpu_seconds;
}

double Picture::Resolve(const std::vector<int64_t>& changed, const TileSource& source,
                        int num_threads, std::vector<int64_t>* resolved) {
  std::vector<char> has_samples(changed.size());
  const double cpu_seconds = ParallelFor(changed.size(), num_threads, [&](size_t i) {
    const TileStatistics statistics = source(changed[i]);
    const int64_t count = statistics.range().size();
    if (count == 0) return;
    has_samples[i] = 1;
    const PixelRect& window = statistics.window();
    const auto first = static_cast<size_t>(planes_.bounds.IndexOf(window.x_begin, window.y_begin));
    std::unique_lock lock(mu_);
    num_samples_ += (count - int64_t{planes_.samples[first]}) * window.area();
    planes_.Resolve(statistics);
  });
  for (size_t i = 0; i < changed.size(); ++i) {
    if (has_samples[i] != 0) resolved->push_back(changed[i]);
  }
  return cpu_seconds;
}

double Picture::Filter(const std::vector<PixelRect>& windows, DenoiseQuality quality,
                       int num_threads) {
  return FilterOnly(windows, quality, num_threads, [&](const FilteredPlanes& part) {
    std::unique_lock lock(mu_);
    CopyPixels(part, &filtered_);
  });
}

double Picture::FilterOnly(std::span<const PixelRect> windows, DenoiseQuality quality,
                           int num_threads,
                           const std::function<void(const FilteredPlanes& part)>& put) {
  FrameFilter& filter = quality == quality_ ? *filter_ : *preview_filter_;
  double cpu_seconds = 0;
  const auto for_each_part = [&](size_t count, const std::function<void(size_t)>& body) {
    cpu_seconds += ParallelFor(count, num_threads, body);
  };
  filter.Filter(planes_, windows, for_each_part, put);
  return cpu_seconds;
}

double Picture::SumErrors(const std::vector<PixelRect>& windows, int num_threads) {
  std::set<int> rows;
  for (const PixelRect& window : windows) {
    for (int y = window.y_begin; y < window.y_end; ++y) rows.insert(y);
  }
  const std::vector<int> stale(rows.begin(), rows.end());
  const PixelRect& region = grid_.region();
  return ParallelFor(stale.size(), num_threads, [&](size_t row) {
    const auto begin = static_cast<size_t>(filtered_.bounds.IndexOf(region.x_begin, stale[row]));
    const size_t end = begin + static_cast<size_t>(region.width());
    RowError sum{.error = 0, .noise = 0};
    for (size_t i = begin; i < end; ++i) {
      sum.error += double{filtered_.relative_error[i]};
      sum.noise += double{filtered_.relative_noise[i]};
    }
    row_errors_[static_cast<size_t>(stale[row] - region.y_begin)] = sum;
  });
}

double Picture::EstimateError() const {
  RowError sum{.error = 0, .noise = 0};
  for (const RowError& row : row_errors_) {
    sum.error += row.error;
    sum.noise += row.noise;
  }
  const double error = std::sqrt(std::max(sum.error, sum.noise) /
                                 (3.0 * static_cast<double>(grid_.region().area())));
  return std::isfinite(error) ? std::max(error, kLeastError) : 0;
}

uint64_t Picture::version() const {
  std::shared_lock lock(mu_);
  return version_;
}

bool Picture::is_refined() const {
  std::shared_lock lock(mu_);
  return is_refined_;
}

double Picture::spp() const {
  std::shared_lock lock(mu_);
  return static_cast<double>(num_samples_) / static_cast<double>(grid_.region().area());
}

double Picture::spp(const PixelRect& region) const {
  const PixelRect part = region.Intersect(grid_.region());
  if (part.empty()) return 0;
  int64_t samples = 0;
  std::shared_lock lock(mu_);
  for (int y = part.y_begin; y < part.y_end; ++y) {
    const auto first = static_cast<size_t>(planes_.bounds.IndexOf(part.x_begin, y));
    for (size_t i = first; i < first + static_cast<size_t>(part.width()); ++i) {
      samples += int64_t{planes_.samples[i]};
    }
  }
  return static_cast<double>(samples) / static_cast<double>(part.area());
}

double Picture::estimated_error() const {
  std::shared_lock lock(mu_);
  return estimated_error_;
}

std::vector<CellError> Picture::CellErrors() const {
  const TileGrid cells(grid_.region(), kCellSizePx);
  std::vector<CellError> errors(static_cast<size_t>(cells.num_tiles()));
  std::shared_lock lock(mu_);
  for (int64_t cell = 0; cell < cells.num_tiles(); ++cell) {
    const PixelRect window = cells.WindowOf(cell);
    CellError& sum = errors[static_cast<size_t>(cell)];
    for (int y = window.y_begin; y < window.y_end; ++y) {
      const auto first = static_cast<size_t>(filtered_.bounds.IndexOf(window.x_begin, y));
      for (size_t i = first; i < first + static_cast<size_t>(window.width()); ++i) {
        sum.error += double{filtered_.relative_error[i]};
        sum.noise += double{filtered_.relative_noise[i]};
      }
    }
    if (sum.noise == 0) sum.noise = sum.error;  // the filter does not tell
  }
  return errors;
}

absl::StatusOr<Image> Picture::Snapshot(const PixelRect& region,
                                        const std::vector<std::string>& layers) const {
  if (region.empty() || !grid_.region().Contains(region)) {
    const PixelRect& all = grid_.region();
    return absl::InvalidArgumentError(
        absl::StrCat("region is not inside what the job renders: ", all.x_begin, ",", all.y_begin,
                     ",", all.width(), ",", all.height()));
  }
  Image image;
  image.data_window = region;
  image.display_window = PixelRect::FromSize(0, 0, settings_.width(), settings_.height());
  std::shared_lock variance_lock(variance_mu_, std::defer_lock);
  if (std::ranges::find(layers, "variance") != layers.end()) variance_lock.lock();
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
