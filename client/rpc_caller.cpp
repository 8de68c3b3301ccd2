#include "client/rpc_caller.h"

#include <algorithm>
#include <condition_variable>
#include <mutex>
#include <utility>

#include "absl/strings/str_cat.h"

namespace tessera {
namespace {

void InterruptibleSleep(std::chrono::milliseconds duration, std::stop_token stop) {
  std::mutex mutex;
  std::condition_variable_any wake;
  std::unique_lock lock(mutex);
  wake.wait_for(lock, stop, duration, [] { return false; });
}

}  // namespace

RpcCaller::RpcCaller(const Peer& peer, std::string token, RetryOptions options)
    : peer_(peer), token_(std::move(token)), options_([&] {
        if (!options.sleep) options.sleep = InterruptibleSleep;
        return std::move(options);
      }()) {}

absl::Status RpcCaller::Call(const std::function<grpc::Status(grpc::ClientContext*)>& call,
                             std::stop_token stop) {
  return Repeat([&](grpc::ClientContext* context, bool*) { return call(context); }, true, stop);
}

absl::Status RpcCaller::Stream(
    const std::function<grpc::Status(grpc::ClientContext*, bool*)>& call, std::stop_token stop) {
  return Repeat(call, false, stop);
}

absl::Status RpcCaller::Repeat(
    const std::function<grpc::Status(grpc::ClientContext*, bool*)>& call, bool with_deadline,
    std::stop_token stop) {
  std::chrono::milliseconds backoff = options_.backoff_min;
  int attempts = 0;
  for (;;) {
    if (stop.stop_requested()) return absl::CancelledError("interrupted");
    grpc::ClientContext context;
    if (with_deadline) {
      context.set_deadline(std::chrono::system_clock::now() + options_.call_timeout);
    }
    if (!token_.empty()) context.AddMetadata("authorization", absl::StrCat("Bearer ", token_));
    grpc::Status status;
    bool progressed = false;
    {
      std::stop_callback cancel(stop, [&context] { context.TryCancel(); });
      status = call(&context, &progressed);
    }
    if (!IsTransient(status)) {
      if (stop.stop_requested() && status.error_code() == grpc::StatusCode::CANCELLED) {
        return absl::CancelledError("interrupted");
      }
      reached_ = true;
      return ToAbslStatus(status, peer());
    }
    if (progressed) {
      reached_ = true;
      attempts = 0;
      backoff = options_.backoff_min;
    }
    ++attempts;
    if (attempts >= (reached_ ? options_.attempts_max : options_.first_contact_attempts)) {
      return ToAbslStatus(status, peer());
    }
    options_.sleep(backoff, stop);
    backoff = std::min(backoff * 2, options_.backoff_max);
  }
}

}  // namespace tessera
