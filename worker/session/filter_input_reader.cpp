#include "worker/session/filter_input_reader.h"

#include <chrono>

#include "worker/session/grpc_status.h"

namespace tessera {
namespace {

constexpr std::chrono::seconds kDeadline{60};

}  // namespace

absl::StatusOr<std::string> FilterInputReader::Read(uint64_t task, const std::string& worker,
                                                    const v1::FilterLease& lease) {
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() + kDeadline);
  {
    std::lock_guard lock(mu_);
    if (stopped_) return absl::CancelledError("the worker stops");
    under_way_[task] = &context;
  }
  v1::ReadFilterInputRequest request;
  request.set_worker(worker);
  request.set_lease_id(lease.id());
  const auto reader = stub_->ReadFilterInput(&context, request);
  const auto bytes_max = static_cast<size_t>(lease.input_bytes());
  std::string bytes;
  v1::ReadFilterInputResponse response;
  while (reader->Read(&response)) {
    if (response.chunk().size() > bytes_max - bytes.size()) {
      context.TryCancel();
      break;
    }
    bytes += response.chunk();
  }
  const absl::Status status = FromGrpc(reader->Finish());
  std::lock_guard lock(mu_);
  under_way_.erase(task);
  if (!status.ok()) return status;
  return bytes;
}

void FilterInputReader::Cancel(uint64_t task) {
  std::lock_guard lock(mu_);
  if (const auto context = under_way_.find(task); context != under_way_.end()) {
    context->second->TryCancel();
  }
}

void FilterInputReader::Stop() {
  std::lock_guard lock(mu_);
  stopped_ = true;
  for (const auto& [task, context] : under_way_) context->TryCancel();
}

}  // namespace tessera
