#include "worker/session/window_filter.h"

#include <functional>
#include <memory>
#include <span>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/denoise/frame_filter.h"
#include "core/denoise/window_codec.h"
#include "worker/session/session_machine.h"
#include "worker/session/thread_time.h"

namespace tessera {
namespace {

constexpr int kSideMaxPx = 1 << 16;

bool IsRegion(const v1::Region& r) {
  return r.width() > 0 && r.height() > 0 && r.x() >= 0 && r.y() >= 0 && r.x() <= kSideMaxPx &&
         r.y() <= kSideMaxPx && r.width() <= kSideMaxPx && r.height() <= kSideMaxPx;
}

PixelRect RectOf(const v1::Region& r) {
  return PixelRect::FromSize(r.x(), r.y(), r.width(), r.height());
}

DenoiseQuality QualityOf(const v1::FilterLease& lease) {
  return lease.quality() == v1::QUALITY_PREVIEW ? DenoiseQuality::kPreview
                                                : DenoiseQuality::kFinal;
}

}  // namespace

std::string FaultOfFilterLease(const v1::FilterLease& lease) {
  if (!IsRegion(lease.frame()) || !IsRegion(lease.window()) || !IsRegion(lease.bounds())) {
    return "a region is impossible";
  }
  const PixelRect frame = RectOf(lease.frame()), window = RectOf(lease.window());
  const PixelRect bounds = RectOf(lease.bounds());
  if (!frame.Contains(bounds) || !bounds.Contains(window) ||
      window.area() > SessionMachine::kLeasePixelsMax ||
      bounds.area() > SessionMachine::kFilterInputPixelsMax) {
    return "the window is outside its planes or too large";
  }
  // 32 planes of 4 bytes, and what their headers and incompressible frames take more.
  if (lease.input_bytes() < 1 || lease.input_bytes() > 136 * bounds.area() + 65536) {
    return "its planes are larger than possible";
  }
  return "";
}

absl::StatusOr<v1::FilteredWindow> FilterWindow(const v1::FilterLease& lease,
                                                std::string_view input,
                                                const std::atomic<bool>& cancelled,
                                                std::atomic<int64_t>* parts_done) {
  const int64_t begin_ns = ThreadNanoseconds();
  if (static_cast<int64_t>(input.size()) != lease.input_bytes() ||
      PayloadChecksum(input) != lease.input_checksum()) {
    return absl::InvalidArgumentError("the window's planes were damaged on their way");
  }
  const absl::StatusOr<std::unique_ptr<Denoiser>> denoiser = MakeDenoiser(lease.denoiser());
  if (!denoiser.ok()) return denoiser.status();
  const PixelRect frame = RectOf(lease.frame()), window = RectOf(lease.window());
  const PixelRect bounds = RectOf(lease.bounds());
  const DenoiseQuality quality = QualityOf(lease);
  if (!bounds.Contains(window.Expand((*denoiser)->halo_px(quality)).Intersect(frame))) {
    return absl::InvalidArgumentError("the window's planes lack what the filter reads");
  }
  const absl::StatusOr<FramePlanes> planes = DecodeFilterInput(bounds, input);
  if (!planes.ok()) return planes.status();

  FilteredPlanes filtered(window);
  const auto one_by_one = [&](size_t count, const std::function<void(size_t)>& body) {
    for (size_t i = 0; i < count && !cancelled; ++i) {
      body(i);
      parts_done->fetch_add(1, std::memory_order_relaxed);
    }
  };
  const std::unique_ptr<FrameFilter> filter =
      (*denoiser)->MakeFrameFilter({frame, quality}, bounds);
  filter->Filter(*planes, {&window, 1}, one_by_one,
                 [&](const FilteredPlanes& part) { CopyPixels(part, &filtered); });
  if (cancelled) return absl::CancelledError("the window was taken back");

  v1::FilteredWindow out;
  out.set_lease_id(lease.id());
  out.set_job(lease.job());
  out.set_revision(lease.revision());
  *out.mutable_window() = lease.window();
  out.set_payload(EncodeFiltered(filtered));
  out.set_checksum(
      FilteredChecksum({lease.id(), lease.job(), lease.revision(), window}, out.payload()));
  const int64_t nanoseconds = ThreadNanoseconds() - begin_ns;
  out.mutable_filter_time()->set_seconds(nanoseconds / 1000000000);
  out.mutable_filter_time()->set_nanos(static_cast<int32_t>(nanoseconds % 1000000000));
  return out;
}

}  // namespace tessera
