#include "worker/session/work_stream.h"

#include <utility>

#include "worker/session/grpc_status.h"

namespace tessera {

WorkStream::WorkStream(v1::WorkerService::Stub& stub, Post post) : post_(std::move(post)) {
  stub.async()->Work(&context_, this);
  AddHold();  // writes start outside of reactions, until the read side has ended
  StartRead(&incoming_);
  StartCall();
}

WorkStream::~WorkStream() {
  context_.TryCancel();
  std::unique_lock lock(mu_);
  done_cv_.wait(lock, [this] { return done_; });
}

void WorkStream::Write(v1::WorkerMessage message) {
  outgoing_ = std::move(message);
  {
    std::lock_guard lock(mu_);
    if (readable_) {
      StartWrite(&outgoing_);
      return;
    }
  }
  post_(session_event::WriteDone{false});
}

void WorkStream::HalfClose() {
  std::lock_guard lock(mu_);
  if (readable_) StartWritesDone();
}

void WorkStream::Abort() { context_.TryCancel(); }

void WorkStream::OnReadDone(bool ok) {
  if (ok) {
    post_(session_event::Received{std::move(incoming_)});
    incoming_.Clear();
    StartRead(&incoming_);
    return;
  }
  std::lock_guard lock(mu_);
  readable_ = false;
  RemoveHold();
}

void WorkStream::OnWriteDone(bool ok) { post_(session_event::WriteDone{ok}); }

void WorkStream::OnDone(const grpc::Status& status) {
  post_(session_event::StreamClosed{FromGrpc(status)});
  std::lock_guard lock(mu_);
  done_ = true;
  done_cv_.notify_all();
}

}  // namespace tessera
