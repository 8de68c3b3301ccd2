// Whether an address may be spoken to in plain text.
#pragma once

#include <string_view>

#include "absl/status/status.h"

namespace tessera {

// Errors: INVALID_ARGUMENT  not HOST:PORT, or plain text to another machine without `insecure`
absl::Status CheckAddress(std::string_view address, bool insecure);

}  // namespace tessera
