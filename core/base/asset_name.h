// The one rule by which a URI in a scene file becomes the name of an asset: client and worker must
// agree on it.
#pragma once

#include <string>
#include <string_view>

#include "absl/status/statusor.h"

namespace tessera {

// Decodes %XX (a '%' without two hexadecimal digits stands for itself), takes '\' for '/', and
// drops ".", empty and "x/.." parts. The result is relative and stays inside the scene's folder.
// Errors: INVALID_ARGUMENT: a clause about the name, with the remedy ("leaves the scene's folder:
// ..."), for an empty, absolute or escaping name, a URI with a scheme, or a zero byte.
absl::StatusOr<std::string> AssetNameFromUri(std::string_view uri);

}  // namespace tessera
