// What decides the bits of a picture (C2): ISA classes, by their x86-64 level, and arithmetic.
#pragma once

#include <algorithm>
#include <array>
#include <string_view>

namespace tessera {

// What a job may ask for, the default first.
inline constexpr std::array<const char*, 3> kIsaClasses = {"x86-64-v3", "x86-64-v4", "x86-64-v2"};

// Whether `text` can be a fingerprint of a machine's arithmetic (Hello.arithmetic).
inline bool IsArithmetic(std::string_view text) {
  return text.size() == 16 && std::ranges::all_of(text, [](char c) {
           return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f');
         });
}

// What a user writes for none in particular.
inline constexpr char kAnyArithmetic[] = "any";

}  // namespace tessera
