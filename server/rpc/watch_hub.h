// The watchers of jobs: each gets the latest state of its job, at most one message under way, never
// more often than it asked for. A slow reader skips states and costs no memory.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <set>

#include <grpcpp/support/server_callback.h>

#include "core/base/pixel_rect.h"
#include "server/coordinator/event.h"
#include "server/coordinator/limits.h"
#include "server/rpc/write_deadlines.h"
#include "tessera/v1/job.pb.h"

namespace tessera {

class WatchReactor;

// What a watch keeps while it is open; both may be null.
struct WatchKeeps {
  std::unique_ptr<WriteDeadlines::Watch> deadline{};
  std::shared_ptr<void> hold{};  // of a client's limits
};

struct WatchCallbacks {
  // The job as it is now; false if it does not exist.
  std::function<bool(JobId, v1::Job*)> get_job;
  // A watcher came, or went, that looks at the region; absent: all; without pixels: nothing.
  std::function<void(JobId, const std::optional<PixelRect>& region)> added, removed;
};

// Threads: all methods from any thread.
class WatchHub {
 public:
  // watches_max: further ones end with RESOURCE_EXHAUSTED.
  explicit WatchHub(WatchCallbacks callbacks, int watches_max = kWatchesMax);

  // The reactor of a new watch stream. It deletes itself. The request's region, if any, is inside
  // the frame, or without pixels.
  grpc::ServerWriteReactor<v1::Job>* Watch(JobId job, const v1::WatchJobRequest& request,
                                           WatchKeeps keeps = {});
  // The job has changed, or is gone. Never blocks, takes no lock but its own.
  void Notify(JobId job);
  // Sends what is due. Call it every few milliseconds, not under a lock.
  void Pump();
  // Ends all streams with UNAVAILABLE; later ones end at once.
  void Close();

 private:
  friend class WatchReactor;
  void Remove(WatchReactor* reactor, JobId job, const std::optional<PixelRect>& region);

  const WatchCallbacks callbacks_;
  const int watches_max_;
  // Pump and Watch hold mu_, then a reactor's, then the coordinator's; Notify, which is called
  // under the coordinator's lock, takes changed_mu_ alone.
  std::mutex mu_;  // guards reactors_, num_watches_, closed_
  std::map<JobId, std::set<WatchReactor*>> reactors_;
  int num_watches_ = 0;
  bool closed_ = false;
  std::mutex changed_mu_;  // guards changed_
  std::set<JobId> changed_;
};

}  // namespace tessera
