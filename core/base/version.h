// The build's version. Workers serve a server of the same version only: another build may draw
// other bits (C2).
#pragma once

namespace tessera {

inline constexpr char kVersion[] = "0.1.0";  // as project(VERSION) in CMakeLists.txt

}  // namespace tessera
