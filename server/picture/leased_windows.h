// The windows of one picture that workers filter while it is refined, and what is known of when
// that pays (docs/decisions/0014). FilterDesk is between them and the coordinator.
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "core/denoise/denoiser.h"
#include "server/coordinator/event.h"
#include "server/picture/views.h"

namespace tessera {

// A window that a worker may filter, with the planes that it needs.
struct FilterOffer {
  PixelRect frame, window, bounds;  // bounds: of the planes
  std::string denoiser;
  v1::Quality quality = v1::QUALITY_FINAL;
  uint64_t revision = 0;
  std::shared_ptr<const std::string> input{};  // core/denoise/window_codec.h
};

class FilterDesk;

// Threads: Deliver from any thread, the rest from one at a time.
class LeasedWindows {
 public:
  struct Answer {
    PixelRect window{};
    std::shared_ptr<const FilteredPlanes> planes{};  // null: to be filtered here
    std::string host{};
    bool is_audited = false;  // to be filtered here as well, and compared
  };

  // `desk` must outlive it.
  LeasedWindows(FilterDesk& desk, JobId job) : desk_(desk), job_(job) {}
  ~LeasedWindows();  // takes all back

  // How many windows workers would take now.
  int64_t Room() const;
  // Whether to lease another window while `pixels` are to be filtered, of which this process is
  // about to filter pixels_here.
  bool Pays(int64_t pixels, int64_t pixels_here, int num_threads) const;
  void Offer(FilterOffer offer);
  // The answers that have come.
  std::vector<Answer> Take();
  // When nothing else is to be done: waits for an answer a little while (less than a preview's
  // interval). Once that has taken as long as filtering what is out here, takes a few back, the
  // oldest first: those windows.
  std::vector<PixelRect> AwaitOrTakeBack(int num_threads);
  // Nothing is out and nothing has come.
  bool empty() const;
  // Whether something is out, or has come, that shares a pixel with `views`.
  bool Meets(const Views& views) const;
  void NoteOwnSpeed(int64_t pixels, double cpu_seconds);
  void ReportLie(const std::string& host);

  // From the desk. planes: null when no worker filters it.
  void Deliver(uint64_t ticket, Answer answer);

 private:
  using Clock = std::chrono::steady_clock;

  FilterDesk& desk_;
  const JobId job_;
  bool waits_ = false;
  Clock::time_point waits_since_;  // while waits_
  mutable std::mutex mu_;
  std::condition_variable answered_;
  std::map<uint64_t, PixelRect> out_;  // by ticket, so oldest first; guarded by mu_
  std::vector<Answer> answers_;        // guarded by mu_
};

}  // namespace tessera
