// The short form of fuzzing that every run of the tests does: seeds are taken, and seeded random
// damage to them is survived. scripts/fuzz searches for longer, guided by coverage.
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>

#include "tests/fuzz/fuzz_target.h"

namespace tessera {
namespace {

constexpr int kMutationsOfSeed = 400;

size_t Below(std::mt19937_64& random, size_t end) { return random() % std::max<size_t>(end, 1); }

// Numbers at which arithmetic and tables break.
std::string OddNumber(std::mt19937_64& random) {
  static const char* const kNumbers[] = {
      "-1", "0", "1e999", "-0.0", "4294967295", "2147483648", "9223372036854775807", "1e-320"};
  return kNumbers[Below(random, std::size(kNumbers))];
}

void Mutate(std::mt19937_64& random, std::string* bytes) {
  const size_t at = Below(random, bytes->size());
  const size_t length = 1 + Below(random, std::min<size_t>(16, bytes->size() - at));
  switch (random() % 7) {
    case 0:  // a bit
      if (!bytes->empty()) (*bytes)[at] ^= static_cast<char>(1 << (random() % 8));
      break;
    case 1:  // a byte of every kind, 0 and 255 often
      if (!bytes->empty()) {
        const char edges[] = {0, '\xff', '\x7f', '\x80', static_cast<char>(random())};
        (*bytes)[at] = edges[random() % std::size(edges)];
      }
      break;
    case 2:
      bytes->resize(at);
      break;
    case 3:
      bytes->erase(at, length);
      break;
    case 4:
      bytes->insert(at, bytes->substr(Below(random, bytes->size()), length));
      break;
    case 5:  // eight bytes as a large or negative number
      for (size_t i = at; i < std::min(at + 8, bytes->size()); ++i) {
        (*bytes)[i] = static_cast<char>(random() % 3 == 0 ? random() : 0xff);
      }
      break;
    case 6: {  // a number in text
      const size_t digit = bytes->find_first_of("0123456789", at);
      if (digit == std::string::npos) break;
      const size_t end = std::min(bytes->find_first_not_of("0123456789.", digit), bytes->size());
      bytes->replace(digit, end - digit, OddNumber(random));
      break;
    }
  }
}

TEST(Fuzz, SeedsAreTaken) {
  const std::vector<std::string> seeds = FuzzSeeds();
  ASSERT_FALSE(seeds.empty());
  for (size_t i = 0; i < seeds.size(); ++i) EXPECT_TRUE(IsTaken(seeds[i])) << "seed " << i;
}

TEST(Fuzz, DamagedSeedsAreSurvived) {
  std::mt19937_64 random(1);
  for (const std::string& seed : FuzzSeeds()) {
    for (int i = 0; i < kMutationsOfSeed; ++i) {
      std::string bytes = seed;
      for (uint64_t edits = 1 + random() % 4; edits > 0; --edits) Mutate(random, &bytes);
      FuzzOne(bytes);
    }
  }
}

TEST(Fuzz, NoiseIsSurvived) {
  std::mt19937_64 random(2);
  FuzzOne("");
  for (int i = 0; i < kMutationsOfSeed; ++i) {
    std::string bytes(Below(random, 300), '\0');
    for (char& byte : bytes) byte = static_cast<char>(random());
    FuzzOne(bytes);
  }
}

// What a fuzzer has found once stays mended.
TEST(Fuzz, FindingsAreSurvived) {
  const std::filesystem::path folder = TESSERA_FUZZ_FINDINGS;
  if (!std::filesystem::exists(folder)) GTEST_SKIP() << "none so far";
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    SCOPED_TRACE(entry.path().string());
    std::ifstream file(entry.path(), std::ios::binary);
    FuzzOne(std::string(std::istreambuf_iterator<char>(file), {}));
  }
}

}  // namespace
}  // namespace tessera
