// The exit codes of the command line: stable, scripts depend on them.
#pragma once

#include "absl/status/status.h"

namespace tessera {

enum ExitCode : int {
  kExitDone = 0,
  kExitBug = 1,
  kExitBadInput = 2,
  kExitUnavailable = 3,
  kExitCancelled = 4,
};

inline ExitCode ExitCodeOf(const absl::Status& status) {
  switch (status.code()) {
    case absl::StatusCode::kOk:
      return kExitDone;
    case absl::StatusCode::kUnavailable:
    case absl::StatusCode::kDeadlineExceeded:
      return kExitUnavailable;
    case absl::StatusCode::kCancelled:
      return kExitCancelled;
    case absl::StatusCode::kInternal:
    case absl::StatusCode::kUnknown:
      return kExitBug;
    default:
      return kExitBadInput;
  }
}

}  // namespace tessera
