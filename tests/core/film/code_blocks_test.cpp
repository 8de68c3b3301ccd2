#include "core/film/code_blocks.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <random>
#include <string>
#include <vector>

namespace tessera {
namespace {

// Codes of at most `width` bits, every `wide_every`-th of up to 32; 0 = none.
std::vector<uint32_t> CodesOf(size_t num_codes, int width, size_t wide_every, uint64_t seed) {
  std::mt19937_64 random(seed);
  std::vector<uint32_t> codes(num_codes);
  for (uint32_t& code : codes) {
    code = static_cast<uint32_t>((random() & UINT32_MAX) >> (32 - width));
    if (wide_every > 0 && random() % wide_every == 0) {
      code = static_cast<uint32_t>((random() & UINT32_MAX) >> (random() % 32));
    }
  }
  return codes;
}

void ExpectRoundTrip(const std::vector<uint32_t>& codes) {
  std::string bytes;
  AppendBlocks(codes, &bytes);
  const std::string expected_rest = "rest";
  bytes += expected_rest;
  std::string_view rest = bytes;
  std::vector<uint32_t> read(codes.size(), 0xdeadbeef);
  ASSERT_TRUE(ReadBlocks(&rest, read));
  EXPECT_EQ(read, codes);
  EXPECT_EQ(rest, expected_rest);
  // One byte less is noticed, whichever block it is that lacks it.
  for (const size_t missing : {size_t{1}, bytes.size() / 2}) {
    std::string_view cut = std::string_view(bytes).substr(
        0, bytes.size() - expected_rest.size() - std::min(missing, bytes.size() - 4));
    EXPECT_EQ(ReadBlocks(&cut, read), codes.empty());
  }
}

TEST(CodeBlocksTest, CodesOfAnyWidthRoundTrip) {
  for (int width = 0; width <= 32; ++width) {
    for (const size_t num_codes : {1, 31, 33, 255, 256, 257, 1024, 4096}) {
      for (const size_t wide_every : {0, 3, 50}) {
        ExpectRoundTrip(CodesOf(num_codes, width, wide_every, num_codes + wide_every));
      }
    }
  }
  ExpectRoundTrip({});
}

TEST(CodeBlocksTest, BlocksAreAsSmallAsTheirCodes) {
  std::string bytes;
  AppendBlocks(std::vector<uint32_t>(1024), &bytes);
  EXPECT_EQ(bytes.size(), 4 * 2u);  // two bytes a block: nothing but zeros
  bytes.clear();
  AppendBlocks(CodesOf(1024, 13, 0, 1), &bytes);
  EXPECT_EQ(bytes.size(), 4 * 2u + 1024 * 13 / 8);
  // One wide code among small ones costs itself, not the width of its block.
  std::vector<uint32_t> codes = CodesOf(256, 5, 0, 1);
  codes[77] = 1u << 28;
  bytes.clear();
  AppendBlocks(codes, &bytes);
  EXPECT_EQ(bytes.size(), 2 + 256 * 5 / 8 + 1 + 3u);
}

TEST(CodeBlocksTest, RefusesWhatAreNoBlocks) {
  std::vector<uint32_t> codes(40);
  const auto reads = [&](std::vector<char> bytes) {
    bytes.resize(4096);
    std::string_view view(bytes.data(), bytes.size());
    return ReadBlocks(&view, codes);
  };
  EXPECT_TRUE(reads({32, 0}));
  EXPECT_FALSE(reads({33, 0}));      // wider than a code
  EXPECT_FALSE(reads({32, 1}));      // nothing is above 32 bits
  EXPECT_TRUE(reads({0, 1, 39, 1}));
  EXPECT_FALSE(reads({0, 1, 40, 1}));  // beyond the last code
}

// Whatever the bytes are, reading stays within them (the sanitizers look on).
TEST(CodeBlocksTest, AnyBytesAreSafe) {
  std::mt19937_64 random(3);
  int num_read = 0;
  for (int trial = 0; trial < 20000; ++trial) {
    std::string bytes(random() % 600, '\0');
    for (char& byte : bytes) byte = static_cast<char>(random());
    if (bytes.size() > 1) {
      bytes[0] = static_cast<char>(random() % 36 | (random() % 4) << 6);
      bytes[1] = static_cast<char>(random() % 16);
    }
    std::vector<uint32_t> codes(1 + random() % 600);
    const std::vector<char> exact(bytes.begin(), bytes.end());  // its end is guarded
    std::string_view view(exact.data(), exact.size());
    num_read += ReadBlocks(&view, codes) ? 1 : 0;
  }
  EXPECT_GT(num_read, 100);
}

}  // namespace
}  // namespace tessera
