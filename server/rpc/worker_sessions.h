// The streams of workers: translates their messages to events and effects to messages. Deltas are
// decoded here, on the stream's own thread, outside the coordinator's lock.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <map>
#include <mutex>

#include <grpcpp/support/byte_buffer.h>
#include <grpcpp/support/server_callback.h>

#include "absl/status/status.h"
#include "server/coordinator/event.h"
#include "server/coordinator/worker_message.h"
#include "tessera/v1/worker.pb.h"

namespace tessera {

class WorkReactor;

// Threads: all methods from any thread.
class WorkerSessions {
 public:
  // v1::WorkerMessages come and v1::CoordinatorMessages go as bytes: a delta's payload is decoded
  // where it lies.
  using Stream = grpc::ServerBidiReactor<grpc::ByteBuffer, grpc::ByteBuffer>;
  using Post = std::function<void(Event)>;
  // with_digests: deltas come with what audits compare, taken on the stream's own thread.
  // find_target: must not wait for the coordinator; may be empty.
  explicit WorkerSessions(Post post, bool with_digests = false, FindFoldTarget find_target = {})
      : post_(std::move(post)), with_digests_(with_digests), find_target_(std::move(find_target)) {}

  // The reactor of a new stream. It deletes itself.
  Stream* Accept(grpc::CallbackServerContext* context);

  // Effects; never block. Unknown sessions are ignored: their stream has ended.
  void Send(SessionId session, const v1::CoordinatorMessage& message);
  void End(SessionId session, const absl::Status& status);
  // Cancels ended streams whose worker does not read its last message. Call it now and then.
  void Pump(int64_t now_ms);
  // The processor time that decoding has taken since the last call of this.
  int64_t TakeDecodeNs() { return decode_ns_.exchange(0); }
  // Ends all streams with UNAVAILABLE; later ones end at once.
  void Close();

 private:
  friend class WorkReactor;
  void Remove(SessionId session);

  const Post post_;
  const bool with_digests_;
  const FindFoldTarget find_target_;
  std::atomic<int64_t> decode_ns_ = 0;
  std::mutex mu_;  // guards all below
  std::map<SessionId, WorkReactor*> reactors_;
  SessionId next_session_ = 1;
  bool closed_ = false;
};

}  // namespace tessera
