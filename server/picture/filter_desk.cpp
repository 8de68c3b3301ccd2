#include "server/picture/filter_desk.h"

#include <utility>

#include "core/denoise/window_codec.h"
#include "server/coordinator/coordinator.h"
#include "server/coordinator/job_settings.h"

namespace tessera {
namespace {

// Before anything is measured: about what the default filter takes.
constexpr double kUnknownSecondsPerPixel = 1e-5;

}  // namespace

int64_t FilterDesk::Room(JobId job) const {
  // What is filtered here as well anyway need not be filtered elsewhere.
  const bool gains_nothing = options_.filter_on == FilterOn::kAuto && options_.audit_rate >= 1;
  return options_.filter_on == FilterOn::kServer || gains_nothing ? 0 : room_(job);
}

uint64_t FilterDesk::NewTicket() {
  std::lock_guard lock(mu_);
  return ++last_ticket_;
}

void FilterDesk::Offer(JobId job, uint64_t ticket, FilterOffer offer, LeasedWindows* windows) {
  FilterOfferEvent event{.ticket = ticket};
  event.lease.set_job(JobName(job));
  event.lease.set_denoiser(offer.denoiser);
  event.lease.set_quality(offer.quality);
  *event.lease.mutable_frame() = RegionProto(offer.frame);
  *event.lease.mutable_window() = RegionProto(offer.window);
  *event.lease.mutable_bounds() = RegionProto(offer.bounds);
  event.lease.set_revision(offer.revision);
  event.lease.set_input_bytes(static_cast<int64_t>(offer.input->size()));
  event.lease.set_input_checksum(PayloadChecksum(*offer.input));
  {
    std::lock_guard lock(mu_);
    ++totals_.windows_offered;
    totals_.input_bytes += event.lease.input_bytes();
    out_[ticket] = {windows, std::move(offer.input)};
  }
  post_(std::move(event));
}

void FilterDesk::Withdraw(uint64_t ticket, bool is_late) {
  {
    std::lock_guard lock(mu_);
    if (out_.erase(ticket) == 0) return;
  }
  post_(FilterWithdrawEvent{ticket, is_late});
}

double FilterDesk::OwnSeconds(int64_t pixels, int num_threads) const {
  std::lock_guard lock(mu_);
  const double seconds =
      own_seconds_per_pixel_ > 0 ? own_seconds_per_pixel_ : kUnknownSecondsPerPixel;
  return seconds * static_cast<double>(pixels) / num_threads;
}

void FilterDesk::NoteOwnSpeed(int64_t pixels, double cpu_seconds) {
  const double now = cpu_seconds / static_cast<double>(pixels);
  std::lock_guard lock(mu_);
  totals_.own_pixels += pixels;
  own_seconds_per_pixel_ =
      own_seconds_per_pixel_ == 0 ? now : 0.5 * (own_seconds_per_pixel_ + now);
}

void FilterDesk::ReportLie(const std::string& host) { post_(FilterLieEvent{host}); }

void FilterDesk::Answer(const FilterAnswerEffect& effect) {
  std::lock_guard lock(mu_);
  const auto found = out_.find(effect.ticket);
  if (found == out_.end()) return;
  const bool is_audited = effect.planes != nullptr && IsAudited(effect.ticket);
  totals_.windows_audited += is_audited;
  found->second.windows->Deliver(
      effect.ticket, {.planes = effect.planes, .host = effect.host, .is_audited = is_audited});
  out_.erase(found);
}

std::shared_ptr<const std::string> FilterDesk::InputOf(uint64_t ticket) const {
  std::lock_guard lock(mu_);
  const auto found = out_.find(ticket);
  return found == out_.end() ? nullptr : found->second.input;
}

FilterDesk::Totals FilterDesk::totals() const {
  std::lock_guard lock(mu_);
  return totals_;
}

bool FilterDesk::IsAudited(uint64_t ticket) const {
  // SplitMix64's finaliser (Steele, Lea & Flood 2014).
  uint64_t x = options_.audit_seed + ticket * 0x9e3779b97f4a7c15u;
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9u;
  x = (x ^ (x >> 27)) * 0x94d049bb133111ebu;
  return static_cast<double>((x ^ (x >> 31)) >> 11) * 0x1p-53 < options_.audit_rate;
}

}  // namespace tessera
