// Streams to clients that do not read end after a while, and what they hold is freed.
#pragma once

#include <cstdint>
#include <map>
#include <mutex>

#include <grpcpp/server_context.h>

namespace tessera {

// Threads: all methods from any thread.
class WriteDeadlines {
 public:
  // deadline_ms: how long one write may take.
  explicit WriteDeadlines(int64_t deadline_ms) : deadline_ms_(deadline_ms) {}

  // A stream's place here; the stream owns it and it must go before the context does.
  class Watch {
   public:
    Watch(WriteDeadlines* deadlines, grpc::CallbackServerContext* context)
        : deadlines_(deadlines), context_(context) {}
    ~Watch() { End(); }
    Watch(const Watch&) = delete;
    Watch& operator=(const Watch&) = delete;
    // A write begins, or has ended.
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
    grpc::CallbackServerContext* const context_;
  };

  // Cancels the streams whose write has taken too long; returns how many. Call it now and then.
  int Pump(int64_t now_ms) {
    std::lock_guard lock(mu_);
    return static_cast<int>(std::erase_if(writes_, [&](const auto& write) {
      if (now_ms - write.second < deadline_ms_) return false;
      write.first->context_->TryCancel();
      return true;
    }));
  }

 private:
  const int64_t deadline_ms_;
  std::mutex mu_;  // guards writes_
  std::map<Watch*, int64_t> writes_;  // that are under way -> monotonic moment of their begin
};

}  // namespace tessera
