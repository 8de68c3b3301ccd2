#include "core/base/version.h"

#include "core/base/build_id.h"

namespace tessera {

const char* const kVersion = TESSERA_RELEASE "+" TESSERA_BUILD_ID;

}  // namespace tessera
