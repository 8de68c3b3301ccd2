// Runs a Coordinator for many threads: one lock, the clock, and effects handed on in order.
#pragma once

#include <atomic>
#include <functional>
#include <mutex>
#include <utility>
#include <vector>

#include "server/coordinator/coordinator.h"

namespace tessera {

// Carries out effects. Called under the coordinator's lock, in order: must not block, nor call the
// host back.
class EffectSink {
 public:
  virtual ~EffectSink() = default;
  virtual void Apply(const Effect& effect) = 0;
};

Instant Now();

// Threads: all methods from any thread.
class CoordinatorHost {
 public:
  // `sink` must outlive the host's last Post.
  CoordinatorHost(CoordinatorConfig config, EffectSink& sink,
                  std::function<Instant()> clock = Now);

  struct Answer {
    absl::Status status;
    JobId job = 0;
    bool is_new = false;  // CreateJobEvent
  };
  Answer Post(Event event);
  // The nanoseconds that Post has worked since the last call of this.
  int64_t TakeBusyNs() { return busy_ns_.exchange(0); }

  // Calls query(const Coordinator&) under the lock; it must be quick.
  template <typename Query>
  auto Read(Query&& query) const {
    std::lock_guard lock(mu_);
    return std::forward<Query>(query)(std::as_const(coordinator_));
  }
  // The same if nobody holds the lock; otherwise a default value.
  template <typename Query>
  auto TryRead(Query&& query) const {
    std::unique_lock lock(mu_, std::try_to_lock);
    using Result = decltype(query(std::as_const(coordinator_)));
    return lock ? std::forward<Query>(query)(std::as_const(coordinator_)) : Result{};
  }

 private:
  mutable std::mutex mu_;
  Coordinator coordinator_;  // guarded by mu_
  EffectSink& sink_;
  const std::function<Instant()> clock_;
  std::atomic<int64_t> busy_ns_ = 0;
};

}  // namespace tessera
