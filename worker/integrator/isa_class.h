// ISA classes as users name them (x86-64 micro-architecture levels) and what Embree calls them.
#pragma once

#include <string>

#include "absl/status/statusor.h"

namespace tessera {

// Embree's value of `isa=` for an ISA class.
// Errors: INVALID_ARGUMENT      unknown class, listing the known ones
//         FAILED_PRECONDITION   this machine cannot run it
absl::StatusOr<std::string> EmbreeIsaOf(const std::string& isa_class);

}  // namespace tessera
