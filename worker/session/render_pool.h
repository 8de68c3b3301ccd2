// Threads that render or filter one lease at a time each and encode what they made.
#pragma once

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

#include "absl/status/statusor.h"
#include "core/film/delta_codec.h"
#include "tessera/v1/worker.pb.h"
#include "worker/session/renderer.h"
#include "worker/session/unit_journal.h"

namespace tessera {

// Threads: all methods from any thread.
class RenderPool {
 public:
  // Called once for each task, on a thread of the pool.
  using Done = std::function<void(uint64_t task, absl::StatusOr<v1::TileDelta> delta)>;
  // What a task does instead of rendering, and whom it tells, both on a thread of the pool.
  using Job = std::function<void(const std::atomic<bool>& cancelled,
                                 std::atomic<int64_t>* parts_done)>;

  // journal: gets what the threads have in hand; null = nobody asks.
  RenderPool(int threads, DeltaEncoding encoding, UnitJournal* journal, Done done);
  // Cancels all tasks and joins.
  ~RenderPool();

  void Start(uint64_t task, std::shared_ptr<const Renderer> renderer, const v1::Lease& lease);
  // Runs `job` in its turn instead; it is run, and soon ends, also when it was cancelled.
  void Start(uint64_t task, Job job);
  // The task ends with CANCELLED, or with its delta when it was faster.
  void Cancel(uint64_t task);
  // The camera samples that the task has done so far; 0 once it has ended.
  int64_t SamplesOf(uint64_t task) const;

 private:
  struct Task {
    uint64_t id = 0;
    std::shared_ptr<const Renderer> renderer;  // shared with the cache: may be dropped from it
    v1::Lease lease;
    Job job;  // null: renders
    std::atomic<bool> cancelled = false;
    std::atomic<int64_t> samples_done = 0;
  };
  void Enqueue(std::shared_ptr<Task> task);
  void Run(int slot);  // slot: of the journal
  absl::StatusOr<v1::TileDelta> Render(Task& task) const;

  const DeltaEncoding encoding_;
  UnitJournal* const journal_;
  const Done done_;
  mutable std::mutex mu_;
  std::condition_variable cv_;
  std::deque<std::shared_ptr<Task>> queue_;          // guarded by mu_
  std::map<uint64_t, std::shared_ptr<Task>> alive_;  // guarded by mu_; queued and running
  bool stopping_ = false;                            // guarded by mu_
  std::vector<std::thread> threads_;
};

}  // namespace tessera
