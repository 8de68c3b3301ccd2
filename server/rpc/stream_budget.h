// How many streams of a kind, and how many bytes for them, a server holds at once (C6).
#pragma once

#include <cstdint>
#include <mutex>
#include <string>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"

namespace tessera {

// Threads: all methods from any thread.
class StreamBudget {
 public:
  // what: for messages, "pictures". bytes_max: a single stream may need more.
  StreamBudget(std::string what, int streams_max, int64_t bytes_max)
      : what_(std::move(what)), streams_max_(streams_max), bytes_max_(bytes_max) {}

  // A stream's share; gives it back when it goes.
  class Share {
   public:
    Share() = default;
    ~Share() {
      if (budget_ != nullptr) budget_->GiveBack(bytes_);
    }
    Share(const Share&) = delete;
    Share& operator=(const Share&) = delete;

   private:
    friend class StreamBudget;
    StreamBudget* budget_ = nullptr;
    int64_t bytes_ = 0;
  };

  // Begins a stream. Errors: RESOURCE_EXHAUSTED with the remedy.
  absl::Status Begin(Share* share) {
    std::lock_guard lock(mu_);
    if (streams_ >= streams_max_) return Exhausted();
    ++streams_;
    share->budget_ = this;
    return absl::OkStatus();
  }
  // Takes bytes for a stream that has begun. Errors: as Begin.
  absl::Status Take(int64_t bytes, Share* share) {
    std::lock_guard lock(mu_);
    if (bytes_ > 0 && bytes > bytes_max_ - bytes_) return Exhausted();
    bytes_ += bytes;
    share->bytes_ += bytes;
    return absl::OkStatus();
  }

 private:
  absl::Status Exhausted() const {
    return absl::ResourceExhaustedError(
        absl::StrCat("the server sends ", streams_, " ", what_, " already, as many as it can hold: "
                     "try again when some have been read"));
  }
  void GiveBack(int64_t bytes) {
    std::lock_guard lock(mu_);
    --streams_;
    bytes_ -= bytes;
  }

  const std::string what_;
  const int streams_max_;
  const int64_t bytes_max_;
  std::mutex mu_;  // guards all below
  int streams_ = 0;
  int64_t bytes_ = 0;
};

}  // namespace tessera
