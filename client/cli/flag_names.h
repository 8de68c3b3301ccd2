// A server's refusal names fields of the protocol; people know flags.
#pragma once

#include <string>

namespace tessera {

// The text with every field of JobSettings that a flag sets replaced by that flag.
std::string WithFlagNames(std::string text);

}  // namespace tessera
