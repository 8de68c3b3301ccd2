// Where pictures that are refined meet the coordinator, which leases windows of them to workers:
// keeps their planes until a worker has fetched and filtered them, and hands answers back.
//
// Locks: the coordinator's is taken before the desk's, and the desk's before a picture's windows'.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>

#include "server/coordinator/effect.h"
#include "server/picture/leased_windows.h"

namespace tessera {

enum class FilterOn {
  kServer,   // this process filters all
  kAuto,     // workers filter, too, when this process has more to do than its cores soon clear
  kWorkers,  // whatever a worker takes
};

struct FilterDeskOptions {
  FilterOn filter_on = FilterOn::kAuto;
  double audit_rate = 0;   // of all windows, filtered here as well and compared
  uint64_t audit_seed = 0; // which nobody may guess
  // How long workers are waited for at least when there is nothing else to do.
  double patience_seconds = 0;
};

// Threads: all methods from any thread.
class FilterDesk {
 public:
  // post: to the coordinator; room: Coordinator::FilterRoom.
  FilterDesk(FilterDeskOptions options, std::function<void(Event)> post,
             std::function<int64_t(JobId)> room)
      : options_(options), post_(std::move(post)), room_(std::move(room)) {}

  FilterOn filter_on() const { return options_.filter_on; }
  double patience_seconds() const { return options_.patience_seconds; }

  // From pictures.
  int64_t Room(JobId job) const;
  uint64_t NewTicket();
  // `windows` gets the answer; it must withdraw what has not been answered before it ends.
  void Offer(JobId job, uint64_t ticket, FilterOffer offer, LeasedWindows* windows);
  void Withdraw(uint64_t ticket, bool is_late);
  // How long this process takes for so many pixels, as it took lately.
  double OwnSeconds(int64_t pixels, int num_threads) const;
  void NoteOwnSpeed(int64_t pixels, double cpu_seconds);
  void ReportLie(const std::string& host);

  // From the coordinator's effects; never blocks.
  void Answer(const FilterAnswerEffect& effect);

  // The planes of a window that is out; null = it is not.
  std::shared_ptr<const std::string> InputOf(uint64_t ticket) const;

  struct Totals {
    int64_t windows_offered = 0;
    int64_t input_bytes = 0;        // of them
    int64_t own_pixels = 0;         // refined by this process
    int64_t windows_audited = 0;
  };
  Totals totals() const;

 private:
  struct Out {
    LeasedWindows* windows;
    std::shared_ptr<const std::string> input;
  };
  bool IsAudited(uint64_t ticket) const;

  const FilterDeskOptions options_;
  const std::function<void(Event)> post_;
  const std::function<int64_t(JobId)> room_;
  mutable std::mutex mu_;  // guards all below
  uint64_t last_ticket_ = 0;
  std::map<uint64_t, Out> out_;
  double own_seconds_per_pixel_ = 0;  // of one thread, lately; 0 = nothing measured yet
  Totals totals_;
};

}  // namespace tessera
