// What decides the bits of a picture beside its ISA class, as a fingerprint: approximations that
// the processor divides and takes roots with inside Embree (RCPPS and RSQRTPS, or RCP14PS and
// RSQRT14PS, whose last bits are each maker's own), and the math library's last bits. All else is
// IEEE arithmetic, the same everywhere. docs/decisions/0009-pinned-arithmetic.md
#pragma once

#include <string>

namespace tessera {

// 16 hexadecimal digits, equal on two machines that give the same bits in `isa_class`, which this
// machine must run. Takes some 20 ms, once.
std::string ArithmeticOf(const std::string& isa_class);
// The same, computed anew by each call.
std::string ComputeArithmetic(const std::string& isa_class);

}  // namespace tessera
