// The ISA classes that decide the bits of a picture (C2), by their x86-64 level.
#pragma once

#include <array>

namespace tessera {

// What a job may ask for, the default first.
inline constexpr std::array<const char*, 3> kIsaClasses = {"x86-64-v3", "x86-64-v4", "x86-64-v2"};

}  // namespace tessera
