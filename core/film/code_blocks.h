// Integers that are mostly small, in few bits that are quick to read: blocks of 256 codes with a
// width of their own, eight codes side by side in a vector, and the few wider codes' high bits
// apart. Lemire & Boytsov 2015, "Decoding billions of integers per second through vectorization"
// (vertical layout); Zukowski, Heman, Nes & Boncz 2006, "Super-scalar RAM-CPU cache compression"
// (exceptions). The layout is in docs/delta-format.md.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>

namespace tessera {

// Appends the codes' blocks to `bytes`.
void AppendBlocks(std::span<const uint32_t> codes, std::string* bytes);

// Reads as many codes from the front of `bytes`, and moves it past them. Returns false, with some
// codes written, if there are too few bytes or they are no blocks.
bool ReadBlocks(std::string_view* bytes, std::span<uint32_t> codes);

}  // namespace tessera
