// What workers say, as events of the coordinator: checks and decodes bytes from outside.
#pragma once

#include "absl/status/statusor.h"
#include "server/coordinator/event.h"
#include "tessera/v1/worker.pb.h"

namespace tessera {

// The event that a message of an open session stands for; takes what it needs out of `message`.
// Errors: INVALID_ARGUMENT for what no worker of this version sends, damaged bytes included: the
// session must end.
absl::StatusOr<Event> EventOf(SessionId session, v1::WorkerMessage& message);

}  // namespace tessera
