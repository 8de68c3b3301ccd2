// One call of WorkerService.Work: gRPC's callbacks as session events. Translates, decides nothing.
#pragma once

#include <grpcpp/client_context.h>
#include <grpcpp/support/client_callback.h>

#include <condition_variable>
#include <functional>
#include <memory>
#include <mutex>

#include "tessera/v1/worker.grpc.pb.h"
#include "worker/session/session_machine.h"

namespace tessera {

// Threads: Write, HalfClose, Abort and the destructor from one thread; `post` is called on gRPC's.
class WorkStream : private grpc::ClientBidiReactor<v1::WorkerMessage, v1::CoordinatorMessage> {
 public:
  using Post = std::function<void(SessionEvent)>;

  // Opens the stream. `post` gets Received, WriteDone and at last StreamClosed.
  WorkStream(v1::WorkerService::Stub& stub, Post post);
  // Aborts and waits for the call's end, StreamClosed included.
  ~WorkStream() override;

  // One at a time, until WriteDone.
  void Write(v1::WorkerMessage message);
  void HalfClose();
  void Abort();

 private:
  void OnReadDone(bool ok) override;
  void OnWriteDone(bool ok) override;
  void OnDone(const grpc::Status& status) override;

  const Post post_;
  grpc::ClientContext context_;
  v1::CoordinatorMessage incoming_;
  v1::WorkerMessage outgoing_;
  std::mutex mu_;
  std::condition_variable done_cv_;
  bool readable_ = true;  // guarded by mu_; false: the hold is gone, no operation may start
  bool done_ = false;     // guarded by mu_
};

}  // namespace tessera
