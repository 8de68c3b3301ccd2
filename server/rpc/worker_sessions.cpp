#include "server/rpc/worker_sessions.h"

#include <time.h>

#include <algorithm>
#include <deque>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include <grpcpp/impl/codegen/proto_utils.h>
#include <grpcpp/server_context.h>

#include "absl/strings/str_cat.h"
#include "server/coordinator/worker_message.h"
#include "server/coordinator_host.h"
#include "server/log.h"
#include "server/rpc/rpc_status.h"

namespace tessera {
namespace {

int64_t ThreadNanoseconds() {
  timespec now = {};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return int64_t{now.tv_sec} * 1000000000 + now.tv_nsec;
}

constexpr int64_t kMessagesPerTiming = 8;  // a system call is not for free

constexpr size_t kQueuedMessagesMax = 16384;  // towards one worker that does not read
constexpr int64_t kEndGraceMs = 2000;  // in which an ending stream's last message may go out

// The bytes of a message, which came in pieces. Valid until the thread's next call, and no longer
// than `message`. The memory is the thread's: that of a delta would be the kernel's to clear anew
// each time.
std::string_view BytesOf(const grpc::ByteBuffer& message) {
  thread_local std::vector<grpc::Slice> slices;
  thread_local std::vector<char> bytes;
  slices.clear();
  if (!message.Dump(&slices).ok()) return {};
  if (bytes.size() < message.Length()) bytes.resize(message.Length());
  size_t size = 0;
  for (const grpc::Slice& slice : slices) {
    std::ranges::copy(slice, bytes.begin() + static_cast<std::ptrdiff_t>(size));
    size += slice.size();
  }
  slices.clear();
  return {bytes.data(), size};
}

grpc::ByteBuffer ToBytes(const v1::CoordinatorMessage& message) {
  grpc::ByteBuffer bytes;
  bool is_own = false;
  // Fails for messages of 2 GiB alone.
  grpc::SerializationTraits<v1::CoordinatorMessage>::Serialize(message, &bytes, &is_own);
  return bytes;
}

}  // namespace

class WorkReactor : public WorkerSessions::Stream {
 public:
  WorkReactor(WorkerSessions* sessions, SessionId session, grpc::CallbackServerContext* context)
      : sessions_(sessions), session_(session), context_(context) {}

  void Begin() { StartRead(&incoming_); }

  // Cancels a stream that should have ended, but whose peer does not take what it was sent.
  void Pump(int64_t now_ms) {
    {
      std::lock_guard lock(mu_);
      if (!ending_ || cancelled_ || now_ms - end_ms_ < kEndGraceMs) return;
      cancelled_ = true;
    }
    ServerLog().warn("session={} cancelled: the worker does not read", session_);
    context_->TryCancel();
  }

  void Send(const v1::CoordinatorMessage& message) {
    std::lock_guard lock(mu_);
    if (ending_) return;
    if (outgoing_.size() >= kQueuedMessagesMax) {
      EndLocked(absl::ResourceExhaustedError("the worker does not read its messages"));
      return;
    }
    outgoing_.push_back(ToBytes(message));
    if (!writing_) WriteLocked();
  }

  void End(const absl::Status& status) {
    std::lock_guard lock(mu_);
    EndLocked(status);
  }

  void OnReadDone(bool ok) override {
    if (!ok) return End(absl::OkStatus());
    if (!IsOpen()) return;
    const absl::Status status = Handle(BytesOf(incoming_));
    incoming_.Clear();
    if (!status.ok()) return End(status);
    std::lock_guard lock(mu_);
    if (!ending_) StartRead(&incoming_);
  }
  void OnWriteDone(bool ok) override {
    std::lock_guard lock(mu_);
    writing_ = false;
    outgoing_.pop_front();
    if (!ok) outgoing_.clear();
    if (!outgoing_.empty()) {
      WriteLocked();
    } else if (ending_) {
      FinishLocked();
    }
  }
  void OnCancel() override {
    std::lock_guard lock(mu_);
    cancelled_ = true;
    EndLocked(absl::CancelledError("the stream was cancelled"));
  }
  void OnDone() override {
    if (greeted_) sessions_->post_(WorkerGoneEvent{session_});
    sessions_->Remove(session_);
    delete this;
  }

 private:
  // Turns a message into an event. A status that is not OK ends the stream.
  absl::Status Handle(std::string_view message) {
    const bool is_timed = num_messages_++ % kMessagesPerTiming == 0;
    const int64_t begin_ns = is_timed ? ThreadNanoseconds() : 0;
    absl::StatusOr<Event> event =
        EventOf(session_, message, sessions_->with_digests_, sessions_->find_target_);
    if (is_timed) sessions_->decode_ns_ += kMessagesPerTiming * (ThreadNanoseconds() - begin_ns);
    if (!event.ok()) return event.status();
    const auto* const connected = std::get_if<WorkerConnectedEvent>(&*event);
    if (greeted_ == (connected != nullptr)) {
      return absl::InvalidArgumentError("the first message, and no other, must be hello");
    }
    if (connected != nullptr) {
      greeted_ = true;
      const v1::Hello& hello = connected->hello;
      ServerLog().info("session={} worker connected host={} process={} threads={}", session_,
                       hello.host().substr(0, 256), hello.process_id(), hello.threads());
    }
    sessions_->post_(*std::move(event));
    return absl::OkStatus();
  }

  bool IsOpen() {
    std::lock_guard lock(mu_);
    return !ending_;
  }
  void WriteLocked() {
    writing_ = true;
    // What follows at once goes out with it, in one system call.
    grpc::WriteOptions options;
    if (outgoing_.size() > 1) options.set_buffer_hint();
    StartWrite(&outgoing_.front(), options);
  }
  // Ends once the message under way is out; drops those that wait.
  void EndLocked(const absl::Status& status) {
    if (ending_) return;
    ending_ = true;
    end_ms_ = Now().monotonic_ms;
    status_ = status;
    if (outgoing_.size() > 1) outgoing_.resize(1);
    if (!writing_) FinishLocked();
  }
  void FinishLocked() {
    if (finished_) return;
    finished_ = true;
    if (!status_.ok() && !cancelled_) {
      ServerLog().warn("session={} closed: {}", session_, std::string(status_.message()));
    }
    Finish(ToGrpc(status_));
  }

  WorkerSessions* const sessions_;
  const SessionId session_;
  grpc::CallbackServerContext* const context_;
  grpc::ByteBuffer incoming_;
  bool greeted_ = false;      // reading side only
  int64_t num_messages_ = 0;  // reading side only

  std::mutex mu_;  // guards all below
  std::deque<grpc::ByteBuffer> outgoing_;  // front: being written, if writing_
  absl::Status status_;
  bool writing_ = false;
  bool cancelled_ = false;
  bool ending_ = false;
  int64_t end_ms_ = 0;  // when that began
  bool finished_ = false;
};

WorkerSessions::Stream* WorkerSessions::Accept(grpc::CallbackServerContext* context) {
  std::lock_guard lock(mu_);
  const SessionId session = next_session_++;
  auto* const reactor = new WorkReactor(this, session, context);
  reactors_[session] = reactor;
  if (closed_) {
    reactor->End(absl::UnavailableError("the server is stopping"));
  } else {
    reactor->Begin();
  }
  return reactor;
}

void WorkerSessions::Send(SessionId session, const v1::CoordinatorMessage& message) {
  std::lock_guard lock(mu_);
  const auto it = reactors_.find(session);
  if (it != reactors_.end()) it->second->Send(message);
}

void WorkerSessions::End(SessionId session, const absl::Status& status) {
  std::lock_guard lock(mu_);
  const auto it = reactors_.find(session);
  if (it != reactors_.end()) it->second->End(status);
}

void WorkerSessions::Pump(int64_t now_ms) {
  std::lock_guard lock(mu_);
  for (const auto& [session, reactor] : reactors_) reactor->Pump(now_ms);
}

void WorkerSessions::Close() {
  std::lock_guard lock(mu_);
  closed_ = true;
  for (const auto& [session, reactor] : reactors_) {
    reactor->End(absl::UnavailableError("the server is stopping"));
  }
}

void WorkerSessions::Remove(SessionId session) {
  std::lock_guard lock(mu_);
  reactors_.erase(session);
}

}  // namespace tessera
