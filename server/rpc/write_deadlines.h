// Streams of clients that do not read, or do not send what they have begun, end after a while, and
// what they hold is freed.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <mutex>
#include <utility>

#include <grpcpp/server_context.h>

namespace tessera {

// Threads: all methods from any thread.
class WriteDeadlines {
 public:
  // deadline_ms: how long one write, or the wait for one message, may take.
  explicit WriteDeadlines(int64_t deadline_ms) : deadline_ms_(deadline_ms) {}

  // A stream's place here; the stream owns it and it must go before the context does.
  class Watch {
   public:
    Watch(WriteDeadlines* deadlines, grpc::CallbackServerContext* context)
        : Watch(deadlines, [context] { context->TryCancel(); }) {}
    // give_up: ends the stream; called under a lock that Begin and End take.
    Watch(WriteDeadlines* deadlines, std::function<void()> give_up)
        : deadlines_(deadlines), give_up_(std::move(give_up)) {}
    ~Watch() { End(); }
    Watch(const Watch&) = delete;
    Watch& operator=(const Watch&) = delete;
    // A write or a wait begins, or has ended.
    void Begin(int64_t now_ms) {
      std::lock_guard lock(deadlines_->mu_);
      deadlines_->writes_[this] = now_ms;
    }
    void End() {
      std::lock_guard lock(deadlines_->mu_);
      deadlines_->writes_.erase(this);
    }

   private:
    friend class WriteDeadlines;
    WriteDeadlines* const deadlines_;
    const std::function<void()> give_up_;
  };

  // Ends the streams whose write has taken too long; returns how many. Call it now and then.
  int Pump(int64_t now_ms) {
    std::lock_guard lock(mu_);
    return static_cast<int>(std::erase_if(writes_, [&](const auto& write) {
      if (now_ms - write.second < deadline_ms_) return false;
      write.first->give_up_();
      return true;
    }));
  }

 private:
  const int64_t deadline_ms_;
  std::mutex mu_;  // guards writes_
  std::map<Watch*, int64_t> writes_;  // that are under way -> monotonic moment of their begin
};

}  // namespace tessera
