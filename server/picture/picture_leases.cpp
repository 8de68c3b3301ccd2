// Windows of a picture at workers, and what came from hosts that are not believed any more.
#include <algorithm>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "core/denoise/window_codec.h"
#include "server/picture/parallel.h"
#include "server/picture/picture.h"

namespace tessera {
namespace {

constexpr int kLeasedSidePx = 256;     // of windows that workers filter
constexpr int kLeasedHaloMaxPx = 128;  // kFilterInputPixelsMax

}  // namespace

void Picture::Distrust(const std::string& host) {
  std::unique_lock lock(mu_);
  if (filtered_by_.erase(host) == 0) return;
  is_distrusted_ = true;
  is_refined_ = false;
}

void Picture::DropDistrusted() {
  bool is_distrusted = false;
  {
    std::unique_lock lock(mu_);
    std::swap(is_distrusted, is_distrusted_);
  }
  if (is_distrusted) LeaveWindowToRefine(grid_.region());
}

double Picture::TakeAnswers(std::vector<LeasedWindows::Answer> answers, int num_threads,
                            LeasedWindows& leased) {
  double cpu_seconds = 0;
  std::vector<PixelRect> taken;
  for (const LeasedWindows::Answer& answer : answers) {
    if (answer.planes == nullptr) {
      LeaveWindowToRefine(answer.window);
      continue;
    }
    if (answer.is_audited) {
      const PixelRect windows[] = {answer.window};
      FilteredPlanes own(answer.window);
      cpu_seconds += FilterOnly(windows, quality_, num_threads,
                                [&](const FilteredPlanes& part) { CopyPixels(part, &own); });
      if (!SameBits(own, *answer.planes)) leased.ReportLie(answer.host);
      std::unique_lock lock(mu_);
      CopyPixels(own, &filtered_);
    } else {
      std::unique_lock lock(mu_);
      CopyPixels(*answer.planes, &filtered_);
      filtered_by_.insert(answer.host);
    }
    taken.push_back(answer.window);
  }
  if (!taken.empty()) cpu_seconds += JudgeWindows(taken, num_threads);
  return cpu_seconds;
}

PixelRect Picture::TakeLastWindow() {
  const int64_t columns = grid_.num_columns();
  const int64_t side = std::max<int64_t>(1, kLeasedSidePx / grid_.tile_size());
  const int64_t last = rough_.rbegin()->first;
  const int64_t row_begin = last / columns / side * side;
  const int64_t column_begin = last % columns / side * side;
  PixelRect window;
  for (int64_t row = row_begin; row < row_begin + side; ++row) {
    for (int64_t column = column_begin; column < std::min(column_begin + side, columns); ++column) {
      const auto found = rough_.find(row * columns + column);
      if (found == rough_.end()) continue;
      const PixelRect& part = found->second.part;
      window = window.empty() ? part : Around(window, part);
      rough_.erase(found);
    }
  }
  return window;
}

// Windows come from the frame's end, what is filtered here from its begin.
double Picture::LeaseWindows(int64_t pixels_here, int num_threads, LeasedWindows& leased) {
  const int halo_px = denoiser_->halo_px(quality_);
  if (halo_px > kLeasedHaloMaxPx) return 0;
  int64_t pixels = 0;
  for (const auto& [tile, rough] : rough_) pixels += rough.part.area();
  std::vector<FilterOffer> offers;
  for (int64_t room = leased.Room(); room > 0 && !rough_.empty(); --room) {
    if (!leased.Pays(pixels, pixels_here, num_threads)) break;
    FilterOffer& offer = offers.emplace_back();
    offer.window = TakeLastWindow();
    offer.frame = grid_.region();
    offer.bounds = offer.window.Expand(halo_px).Intersect(grid_.region());
    offer.denoiser = std::string(denoiser_->name());
    offer.quality = settings_.quality() == v1::QUALITY_PREVIEW ? v1::QUALITY_PREVIEW
                                                               : v1::QUALITY_FINAL;
    offer.revision = revision_;
    pixels -= offer.window.area();
  }
  const double cpu_seconds = ParallelFor(offers.size(), num_threads, [&](size_t i) {
    offers[i].input =
        std::make_shared<const std::string>(EncodeFilterInput(planes_, offers[i].bounds));
  });
  for (FilterOffer& offer : offers) leased.Offer(std::move(offer));
  return cpu_seconds;
}

// Nothing is left to do here: what is out is waited for, at most for as long as doing it here takes
// (so at worst twice the time of the better choice), then done here.
void Picture::AwaitLeased(int num_threads, LeasedWindows& leased) {
  for (const PixelRect& window : leased.AwaitOrTakeBack(num_threads)) LeaveWindowToRefine(window);
}

}  // namespace tessera
