// The planes of a window on their way to the worker that is to filter it: one message at a time, as
// the worker takes them.
#pragma once

#include <grpcpp/support/server_callback.h>

#include <algorithm>
#include <memory>
#include <string>
#include <utility>

#include "server/coordinator/limits.h"
#include "tessera/v1/worker.pb.h"

namespace tessera {

// Deletes itself.
class FilterInputStream final : public grpc::ServerWriteReactor<v1::ReadFilterInputResponse> {
 public:
  explicit FilterInputStream(std::shared_ptr<const std::string> input) : input_(std::move(input)) {
    WriteNext();
  }
  void OnWriteDone(bool ok) override { ok ? WriteNext() : Finish(grpc::Status::CANCELLED); }
  void OnDone() override { delete this; }

 private:
  void WriteNext() {
    if (offset_ >= input_->size()) return Finish(grpc::Status::OK);
    const size_t bytes = std::min(input_->size() - offset_, size_t{kChunkBytesMax});
    response_.set_chunk(input_->substr(offset_, bytes));
    offset_ += bytes;
    StartWrite(&response_);
  }

  const std::shared_ptr<const std::string> input_;  // shared with the desk, which may drop it
  size_t offset_ = 0;
  v1::ReadFilterInputResponse response_;
};

}  // namespace tessera
