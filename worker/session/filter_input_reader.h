// Fetches the planes of windows that are to be filtered.
#pragma once

#include <grpcpp/channel.h>
#include <grpcpp/client_context.h>

#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <string>

#include "absl/status/statusor.h"
#include "tessera/v1/worker.grpc.pb.h"

namespace tessera {

// Threads: all methods from any thread.
class FilterInputReader {
 public:
  explicit FilterInputReader(const std::shared_ptr<grpc::Channel>& channel)
      : stub_(v1::WorkerService::NewStub(channel)) {}

  // Blocks until all has come, the task is cancelled or the reader is stopped.
  // Errors: CANCELLED; NOT_FOUND (the lease is gone); UNAVAILABLE and others of the link. Nothing
  // is tried again: the server filters the window itself.
  absl::StatusOr<std::string> Read(uint64_t task, const std::string& worker,
                                   const v1::FilterLease& lease);
  // What the task reads ends at once.
  void Cancel(uint64_t task);
  // So does what all tasks read, now and later.
  void Stop();

 private:
  const std::unique_ptr<v1::WorkerService::Stub> stub_;
  std::mutex mu_;  // guards all below
  bool stopped_ = false;
  std::map<uint64_t, grpc::ClientContext*> under_way_;  // by task
};

}  // namespace tessera
