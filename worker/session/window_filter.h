// Filters the window of a FilterLease: the same bits as the server's own filter.
#pragma once

#include <atomic>
#include <cstdint>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "tessera/v1/worker.pb.h"

namespace tessera {

// Empty when the lease can be filtered.
std::string FaultOfFilterLease(const v1::FilterLease& lease);

// On the calling thread. `input`: what ReadFilterInput gives. parts_done: grows with each part of a
// stage, for heartbeats.
// Errors: INVALID_ARGUMENT (the input is not what the lease says, or a filter that is unknown),
// CANCELLED.
absl::StatusOr<v1::FilteredWindow> FilterWindow(const v1::FilterLease& lease,
                                                std::string_view input,
                                                const std::atomic<bool>& cancelled,
                                                std::atomic<int64_t>* parts_done);

}  // namespace tessera
