#include "server/picture/leased_windows.h"

#include <algorithm>
#include <utility>

#include "server/picture/filter_desk.h"

namespace tessera {
namespace {

// How long own cores may take for what is left before workers are asked: a preview's interval.
constexpr double kBacklogSeconds = 0.1;
constexpr std::chrono::milliseconds kAwait{50};

}  // namespace

LeasedWindows::~LeasedWindows() {
  std::map<uint64_t, PixelRect> out;
  {
    std::lock_guard lock(mu_);
    out.swap(out_);
  }
  for (const auto& [ticket, window] : out) desk_.Withdraw(ticket, false);
}

int64_t LeasedWindows::Room() const { return desk_.Room(job_); }

bool LeasedWindows::Pays(int64_t pixels, int64_t pixels_here, int num_threads) const {
  if (desk_.filter_on() == FilterOn::kWorkers) return true;
  const int64_t left = pixels - pixels_here;
  return left > 0 && desk_.OwnSeconds(left, num_threads) > kBacklogSeconds;
}

void LeasedWindows::Offer(FilterOffer offer) {
  const uint64_t ticket = desk_.NewTicket();
  waits_ = false;
  {
    std::lock_guard lock(mu_);
    out_[ticket] = offer.window;
  }
  desk_.Offer(job_, ticket, std::move(offer), this);
}

std::vector<LeasedWindows::Answer> LeasedWindows::Take() {
  std::lock_guard lock(mu_);
  if (!answers_.empty()) waits_ = false;
  return std::exchange(answers_, {});
}

std::vector<PixelRect> LeasedWindows::AwaitOrTakeBack(int num_threads) {
  std::map<uint64_t, PixelRect> late;
  {
    std::unique_lock lock(mu_);
    if (!answers_.empty() || out_.empty()) return {};
    if (!std::exchange(waits_, true)) waits_since_ = Clock::now();
    if (answered_.wait_for(lock, kAwait, [this] { return !answers_.empty(); })) return {};
    int64_t pixels = 0;
    for (const auto& [ticket, window] : out_) pixels += window.area();
    const std::chrono::duration<double> waited = Clock::now() - waits_since_;
    const double patience_s =
        std::max(desk_.patience_seconds(), desk_.OwnSeconds(pixels, num_threads));
    if (waited.count() < patience_s) return {};
    for (int i = 0; i < num_threads && !out_.empty(); ++i) {
      late.insert(out_.extract(out_.begin()));
    }
  }
  std::vector<PixelRect> windows;
  for (const auto& [ticket, window] : late) {
    desk_.Withdraw(ticket, true);
    windows.push_back(window);
  }
  return windows;
}

bool LeasedWindows::empty() const {
  std::lock_guard lock(mu_);
  return out_.empty() && answers_.empty();
}

bool LeasedWindows::Meets(const Views& views) const {
  std::lock_guard lock(mu_);
  return std::ranges::any_of(out_, [&](const auto& out) { return views.Meets(out.second); }) ||
         std::ranges::any_of(answers_,
                             [&](const Answer& answer) { return views.Meets(answer.window); });
}

void LeasedWindows::NoteOwnSpeed(int64_t pixels, double cpu_seconds) {
  if (pixels > 0) desk_.NoteOwnSpeed(pixels, cpu_seconds);
}

void LeasedWindows::ReportLie(const std::string& host) { desk_.ReportLie(host); }

void LeasedWindows::Deliver(uint64_t ticket, Answer answer) {
  std::lock_guard lock(mu_);
  const auto found = out_.find(ticket);
  if (found == out_.end()) return;
  answer.window = found->second;
  out_.erase(found);
  answers_.push_back(std::move(answer));
  answered_.notify_all();
}

}  // namespace tessera
