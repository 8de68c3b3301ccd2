// The part of SessionMachine that deals with windows of pictures to be filtered.
#include <utility>

#include "absl/strings/str_cat.h"
#include "worker/session/job_conversion.h"
#include "worker/session/session_machine.h"
#include "worker/session/window_filter.h"

namespace tessera {

void SessionMachine::OnFilterLease(v1::FilterLease& lease) {
  const uint64_t id = lease.id();
  if (leases_.contains(id)) return;
  std::string fault;
  if (draining_) {
    Decline(id, v1::DeclineLease::REASON_DRAINING, "the worker is leaving");
    return;
  }
  if (leases_.size() >= kLeasesMax) fault = "too many leases at once";
  if (fault.empty()) fault = FaultOfFilterLease(lease);
  if (!fault.empty()) {
    Decline(id, v1::DeclineLease::REASON_UNSPECIFIED, fault);
    return;
  }
  HeldLease& held = leases_[id];
  held.lease.set_id(id);
  held.filter = std::move(lease);
  waiting_.push_back(id);
  renders_may_start_ = true;
}

uint64_t SessionMachine::EndTask(uint64_t task) {
  const auto ended = tasks_.find(task);
  if (ended == tasks_.end()) return 0;
  const uint64_t lease_id = ended->second.lease;
  tasks_.erase(ended);
  renders_may_start_ = true;
  return lease_id;
}

void SessionMachine::SendResult(uint64_t lease_id, v1::WorkerMessage message) {
  leases_[lease_id].rendered = true;
  LogLine(absl::StrCat("lease=", lease_id, message.has_filtered() ? " filtered" : " rendered"),
          LogLevel::kDebug);
  deltas_.push_back(std::move(message));
}

void SessionMachine::On(session_event::Filtered& event) {
  const uint64_t lease_id = EndTask(event.task);
  if (lease_id == 0) return;
  if (!event.filtered.ok()) {
    Decline(lease_id, v1::DeclineLease::REASON_UNSPECIFIED,
            std::string(event.filtered.status().message()));
    EraseLease(lease_id);
    return;
  }
  v1::WorkerMessage message;
  *message.mutable_filtered() = *std::move(event.filtered);
  SendResult(lease_id, std::move(message));
}

}  // namespace tessera
