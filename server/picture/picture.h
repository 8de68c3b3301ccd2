// The served picture of one job: planes resolved from its film, and the filtered picture, kept up
// to date tile by tile. Previews may be filtered more cheaply than the job asks for. Once refined,
// incremental equals from scratch, bit for bit, however previews went: what a changed tile can
// reach, and what is at preview quality, is filtered again, from what the filter has kept. Of parts
// that somebody looks at these alone are filtered, to the bits of the same parts of the whole.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <shared_mutex>
#include <span>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "core/base/tile_grid.h"
#include "core/denoise/denoiser.h"
#include "core/denoise/frame_filter.h"
#include "core/film/frame_planes.h"
#include "core/image/image.h"
#include "server/coordinator/sample_plan.h"
#include "server/picture/leased_windows.h"
#include "server/picture/views.h"
#include "tessera/v1/job.pb.h"

namespace tessera {

// Threads: Update from one thread at a time; the others from any.
class Picture {
 public:
  // `settings` are complete (CompleteSettings). spares_settled false: previews filter all that has
  // changed, for comparisons.
  explicit Picture(const v1::JobSettings& settings, bool spares_settled = true);

  // Gives the folded statistics of a tile as they are now.
  using TileSource = std::function<TileStatistics(int64_t tile)>;
  // Takes the tiles `changed` from `source`, called on num_threads, and filters of the tiles that
  // meet `views` all that is not up to date: kPreview at preview quality, but for tiles that
  // cannot have changed visibly; kFinal at the job's, with all that previews have left. Of
  // `changed` those that do not reach `views` may be missing, until somebody looks at what they
  // reach. Tiles without samples are passed over. Parts of the picture are served as they become
  // ready. Returns the seconds of CPU that it took, all threads together; 0 if there was nothing to
  // do.
  double Update(const std::vector<int64_t>& changed, const TileSource& source,
                DenoiseQuality quality, int num_threads, const Views& views = Views::Whole());
  // Update at the job's quality in slices, between which others may have the cores: Absorb takes
  // the tiles, then each Refine filters about pixels_max pixels, until IsRefined(views): what meets
  // `first` before the rest of `views`. The same bits for any slices. Both return seconds of CPU.
  double Absorb(const std::vector<int64_t>& changed, const TileSource& source, int num_threads);
  // leased: windows of it that workers filter meanwhile, of the whole picture only, the same for
  // all slices of a refinement; null = none. The same bits with or without, whoever comes back or
  // does not.
  double Refine(int64_t pixels_max, int num_threads, LeasedWindows* leased = nullptr,
                const Views& views = Views::Whole(), const Views& first = {});
  // Whether what meets `views` shows all tiles taken, at the job's quality. Threads: none while
  // another method changes the picture.
  bool IsRefined(const Views& views, const LeasedWindows* leased = nullptr) const;
  // If the host has filtered any of it, has all of it filtered again by the next Refine: the host
  // returned wrong bits. Threads: any.
  void Distrust(const std::string& host);

  // The pixels that it has.
  const PixelRect& region() const { return grid_.region(); }
  // Whether news in the tile can change what tiles that meet `views` show at `quality`.
  bool Reaches(int64_t tile, const Views& views, DenoiseQuality quality) const;
  // Grows with whatever changes what is shown.
  uint64_t version() const;
  // Whether all of `region` (absent: the picture) has been made once, however long ago.
  bool HasShown(const std::optional<PixelRect>& region) const;
  // Whether all of it is at the job's quality.
  bool is_refined() const;
  // How often a preview has left a tile alone that news had reached.
  int64_t num_spared() const { return num_spared_; }
  // Mean samples per pixel that it shows, over what it has of `region`.
  double spp() const;
  double spp(const PixelRect& region) const;
  // Differs between two pictures of a process.
  uint64_t serial() const { return serial_; }
  // Estimated sqrt(relMSE) of the filtered picture (DESIGN.md), from its own error output;
  // 0 = unknown. Deterministic.
  double estimated_error() const;
  // Of the filtered picture, by cell of kCellSizePx pixels whatever the job's tiles. Deterministic.
  std::vector<CellError> CellErrors() const;
  // The named layers over `region`, which must lie in the job's region. While an Update runs, parts
  // of the picture may be newer than others.
  // Errors: INVALID_ARGUMENT naming the layers that there are.
  absl::StatusOr<Image> Snapshot(const PixelRect& region,
                                 const std::vector<std::string>& layers) const;

 private:
  // Notes what they have made stale.
  double TakeTiles(const std::vector<int64_t>& changed, const TileSource& source, int num_threads);
  // The pixels that news in `tiles` can change at `quality`, tile by tile.
  std::map<int64_t, PixelRect> StalePixels(const std::vector<int64_t>& tiles,
                                           DenoiseQuality quality) const;
  // Whether a preview may leave the tile as it is.
  bool MaySpare(int64_t tile) const;
  // Has `stale` filtered at the job's quality by Refine.
  void LeaveToRefine(const std::map<int64_t, PixelRect>& stale);
  // The next rough pixels to be filtered here, taken out of rough_ in the order of tiles until they
  // are pixels_max.
  struct Slice {
    std::vector<int64_t> tiles{}, whole_tiles{};
    std::vector<PixelRect> windows{};  // the parts of the others
    int64_t pixels = 0;
  };
  void TakeSlice(const Views& views, int64_t pixels_max, Slice* slice);
  // The tiles that meet `views` are shown. Needs mu_.
  void NoteShownLocked(const Views& views);
  // Windows at workers: takes in what has come, has what is lost filtered here, leases more of what
  // is left to do. Each returns seconds of CPU.
  double TakeAnswers(std::vector<LeasedWindows::Answer> answers, int num_threads,
                     LeasedWindows& leased);
  double LeaseWindows(int64_t pixels_here, int num_threads, LeasedWindows& leased);
  void AwaitLeased(int num_threads, LeasedWindows& leased);
  // The rough pixels around the last rough tile, up to the size of a lease; they are rough no more.
  PixelRect TakeLastWindow();
  void LeaveWindowToRefine(const PixelRect& window);
  void DropDistrusted();
  bool IsWholeLocked(const LeasedWindows* leased) const;
  bool IsRefinedLocked(const Views& views, const LeasedWindows* leased) const;
  // Filters `windows`, their rows' errors and the estimate from them.
  double FilterWindows(const std::vector<PixelRect>& windows, DenoiseQuality quality,
                       int num_threads);
  // Each returns seconds of CPU.
  double Resolve(const std::vector<int64_t>& changed, const TileSource& source, int num_threads,
                 std::vector<int64_t>* resolved);
  double Filter(const std::vector<PixelRect>& windows, DenoiseQuality quality, int num_threads);
  double FilterOnly(std::span<const PixelRect> windows, DenoiseQuality quality, int num_threads,
                    const std::function<void(const FilteredPlanes& part)>& put);
  // The windows' rows' errors and the estimate from them.
  double JudgeWindows(const std::vector<PixelRect>& windows, int num_threads);
  // Sums the errors of the windows' rows anew.
  double SumErrors(const std::vector<PixelRect>& windows, int num_threads);
  double EstimateError() const;

  const uint64_t serial_;
  const v1::JobSettings settings_;
  const DenoiseQuality quality_;  // the job's
  const bool spares_settled_;
  const TileGrid grid_;
  std::unique_ptr<Denoiser> denoiser_;  // constant after construction
  // At the job's quality and for previews; Update's own.
  std::unique_ptr<FrameFilter> filter_, preview_filter_;

  // Update's thread and those that it starts alone write what follows. The calibrated variance, in
  // planes_, is guarded by variance_mu_ (taken first), all else up to estimated_error_ by mu_.
  mutable std::shared_mutex variance_mu_;
  mutable std::shared_mutex mu_;
  FramePlanes planes_;
  FilteredPlanes filtered_;
  uint64_t version_ = 0;
  bool is_refined_ = true;
  int64_t num_samples_ = 0;
  double estimated_error_ = 0;
  std::vector<char> shown_;  // by tile: whether it has been made once

  // Guarded by mu_: the hosts that have filtered windows of it, and whether one of them is banned.
  std::set<std::string> filtered_by_;
  bool is_distrusted_ = false;

  // What has to be filtered at the job's quality, by tile; Update's own.
  struct Rough {
    PixelRect part;
    bool is_stale = false;  // has changed since it was filtered at preview quality
  };
  std::map<int64_t, Rough> rough_;
  std::atomic<int64_t> num_spared_ = 0;
  uint64_t revision_ = 0;  // of the planes; Update's own
  // Each row's sums of FilteredPlanes::relative_error and relative_noise; Update's own.
  struct RowError {
    double error = std::numeric_limits<double>::infinity();
    double noise = 0;
  };
  std::vector<RowError> row_errors_;
};

// The rectangles that cover exactly the given tiles (ascending), touching tiles joined.
std::vector<PixelRect> JoinTiles(const TileGrid& grid, const std::vector<int64_t>& tiles);

}  // namespace tessera
