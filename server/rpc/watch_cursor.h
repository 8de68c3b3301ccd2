// How far one watch of a job has come: what it has sent, and what is to be sent next. No gRPC,
// clock or locks: the production server and the simulator hold it behind streams of their own.
// Threads: none.
#pragma once

#include <cstdint>
#include <optional>

#include "core/base/sha256.h"
#include "tessera/v1/job.pb.h"

namespace tessera {

class WatchCursor {
 public:
  explicit WatchCursor(const v1::WatchJobRequest& request);

  // The job has changed, or is gone.
  void NoteChange() { changed_ = true; }
  // Whether the job is to be looked at: something may be new, and the interval is over.
  bool IsDue(int64_t now_ms) const { return changed_ && now_ms >= next_ms_; }
  // `job`: as it is now. Returns whether it is to be sent; it is then without what the client has
  // from this stream already, if that was asked for. Whatever another incarnation of the server has
  // sent, a job of this one is newer.
  bool Take(v1::Job* job, int64_t now_ms);
  // What was taken last was the job's end: nothing follows.
  bool ended() const { return ended_; }

 private:
  void LeaveOutWhatIsKnown(v1::Job* job);

  const int64_t interval_ms_;
  const bool only_changes_;
  v1::Revision sent_;
  std::optional<Sha256Digest> known_settings_, known_scene_, known_counts_;  // by the client
  int64_t next_ms_ = 0;
  bool changed_ = true;
  bool ended_ = false;
};

}  // namespace tessera
