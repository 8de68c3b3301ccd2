// What happens to leases, as lines of the server's log.
#pragma once

#include <string>

#include "absl/status/status.h"
#include "server/coordinator/effect.h"
#include "server/coordinator/event.h"

namespace tessera {

// "session=3 job=7 lease=12 tile=4 samples=0..16 granted", and the like for what else is told to a
// worker about a lease; empty for messages that are not about one. samples is half-open.
std::string LineOf(const SendEffect& effect);

// Where a delta comes from and what it is of, without what has become of it.
std::string LineOf(const DeltaEvent& event);

// "session=3 worker=2 job=7 lease=12 tile=4 samples=0..16 expired".
std::string LineOf(const LeaseExpiredEffect& effect);
// The same with "races lease=11 worker=1": the slow lease, and who has it.
std::string LineOf(const RaceBegunEffect& effect);
// "job=7 tile=4 samples=0..16 host=b differs from host=a".
std::string LineOf(const AuditDiffersEffect& effect);

// Log these at the level of --verbose, and do nothing at others. Threads: any.
void LogSent(const SendEffect& effect);
void LogRace(const RaceBegunEffect& effect);
// line: LineOf the delta.
void LogDelta(const std::string& line, const absl::Status& taken_in);

}  // namespace tessera
