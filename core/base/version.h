// The build's version, "0.1.0+1a2b3c4d": the release, then the first digits of a digest over every
// source and the compiler that decide the bits of a picture. Workers serve a server of the same
// version only: another build may draw other bits (C2).
#pragma once

namespace tessera {

extern const char* const kVersion;

}  // namespace tessera
