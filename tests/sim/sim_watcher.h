// A client that watches one job to its end: its streams are cut, it reads slowly, the server dies,
// and it dials in again from the last revision that it has seen.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "server/rpc/watch_cursor.h"
#include "tests/sim/checkers.h"
#include "tests/sim/sim_random.h"
#include "tests/sim/sim_server.h"
#include "tests/sim/virtual_time.h"

namespace tessera {

class SimWatcher {
 public:
  // Until then streams are cut. Draws from numbers of its own, so that schedules stay as they are.
  SimWatcher(uint64_t seed, int64_t faults_end_us, VirtualTime& time, SimServer& server,
             Checkers& checkers)
      : random_(seed),
        faults_end_us_(faults_end_us),
        time_(time),
        server_(server),
        checkers_(checkers) {}

  void Start(const std::string& job);
  // The job has another revision, or is gone.
  void NoteChange();
  // Whether it has seen the job's end.
  bool IsDone() const { return done_; }
  // The job as it is in the end.
  void CheckEnd(const v1::Job& job) const;

 private:
  void Open();
  void Break(const char* why);
  void Pump(uint64_t stream);
  void Deliver(uint64_t stream, const v1::Job& message);
  int64_t Delay() { return random_.Between(1, 30) * kMs; }

  SimRandom random_;
  const int64_t faults_end_us_;
  VirtualTime& time_;
  SimServer& server_;
  Checkers& checkers_;
  std::string job_;
  uint64_t stream_ = 0;  // the number of the one that is open, or was the last
  // The server's end of the stream; null: none is open.
  std::unique_ptr<WatchCursor> cursor_;
  uint64_t server_run_ = 0;  // that the stream is of
  bool writing_ = false;
  bool is_first_ = true;  // no message of this stream has come
  v1::Job seen_;          // put together from what came
  bool done_ = false;
  bool is_gone_ = false;  // deleted
};

}  // namespace tessera
