// What each parser of bytes from outside gives to be fuzzed. One program links one target with one
// of three drivers: mutation_test.cpp (part of the tests), libfuzzer_driver.cpp and
// write_seeds.cpp (preset fuzz, scripts/fuzz).
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace tessera {

// Feeds one input. Whatever it is, returns; aborts if what the parser promises of its result does
// not hold.
void FuzzOne(std::string_view input);

// Valid inputs, small, which together reach every branch of the format; mutations start there.
std::vector<std::string> FuzzSeeds();

// Whether the parser takes the input: seeds must be taken, or mutations of them test nothing.
bool IsTaken(std::string_view input);

}  // namespace tessera
