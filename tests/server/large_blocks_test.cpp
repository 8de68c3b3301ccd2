#include "server/memory/large_blocks.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <cstring>
#include <random>
#include <set>
#include <thread>
#include <vector>

namespace tessera {
namespace {

constexpr size_t kTileBytes = 20 * 2 * 4 * 1024;

TEST(LargeBlocks, LeavesSmallAndHugeSizesToMalloc) {
  EXPECT_EQ(AllocateLargeBlock(0), nullptr);
  EXPECT_EQ(AllocateLargeBlock(4095), nullptr);
  EXPECT_EQ(AllocateLargeBlock(size_t{2} << 20), nullptr);
  EXPECT_EQ(AllocateLargeBlock(SIZE_MAX), nullptr);
  int on_the_stack = 0;
  EXPECT_FALSE(IsLargeBlock(&on_the_stack));
  EXPECT_FALSE(IsLargeBlock(nullptr));
}

TEST(LargeBlocks, GivesOutWhatWasGivenBack) {
  void* const first = AllocateLargeBlock(kTileBytes);
  ASSERT_NE(first, nullptr);
  EXPECT_TRUE(IsLargeBlock(first));
  EXPECT_EQ(reinterpret_cast<uintptr_t>(first) % 256, 0);
  FreeLargeBlock(first);
  void* const second = AllocateLargeBlock(kTileBytes);
  EXPECT_EQ(second, first);
  FreeLargeBlock(second);
}

// Seeded; sizes of all kinds come and go, and no block loses a byte to another one.
TEST(LargeBlocks, BlocksDoNotOverlap) {
  struct Block {
    unsigned char* begin;
    size_t bytes;
    unsigned char fill;
  };
  std::mt19937 random(7);
  std::vector<Block> blocks;
  const auto check_and_free = [&](size_t index) {
    const Block block = blocks[index];
    for (size_t i = 0; i < block.bytes; i += 997) ASSERT_EQ(block.begin[i], block.fill);
    ASSERT_EQ(block.begin[block.bytes - 1], block.fill);
    FreeLargeBlock(block.begin);
    blocks[index] = blocks.back();
    blocks.pop_back();
  };
  for (int step = 0; step < 4000; ++step) {
    if (blocks.size() < 40 && random() % 3 > 0) {
      const size_t bytes = 4096 + random() % (random() % 8 == 0 ? 2000000 : 200000);
      auto* const begin = static_cast<unsigned char*>(AllocateLargeBlock(bytes));
      ASSERT_NE(begin, nullptr);
      const auto fill = static_cast<unsigned char>(random());
      std::memset(begin, fill, bytes);
      blocks.push_back({begin, bytes, fill});
    } else if (!blocks.empty()) {
      check_and_free(random() % blocks.size());
    }
    if (step % 500 == 0) TrimLargeBlocks();
  }
  while (!blocks.empty()) check_and_free(blocks.size() - 1);
}

TEST(LargeBlocks, EmptySlabsGoBackToTheKernelAndComeAgain) {
  for (int i = 0; i < 200; ++i) TrimLargeBlocks();  // what other tests have left
  std::vector<void*> blocks;
  for (int i = 0; i < 200; ++i) blocks.push_back(AllocateLargeBlock(kTileBytes));
  const size_t bytes = LargeBlockBytes();
  EXPECT_GE(bytes, 200 * kTileBytes);
  TrimLargeBlocks();
  TrimLargeBlocks();
  EXPECT_EQ(LargeBlockBytes(), bytes);  // none is empty
  for (void* const block : blocks) FreeLargeBlock(block);
  EXPECT_EQ(LargeBlockBytes(), bytes);  // kept for what comes next
  for (int i = 0; i < 200; ++i) TrimLargeBlocks();
  EXPECT_EQ(LargeBlockBytes(), 0);
  std::set<void*> again;
  for (int i = 0; i < 200; ++i) {
    void* const block = AllocateLargeBlock(kTileBytes);
    std::memset(block, i, kTileBytes);
    EXPECT_TRUE(again.insert(block).second);
  }
  for (void* const block : again) FreeLargeBlock(block);
}

TEST(LargeBlocks, ManyThreads) {
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([t] {
      for (int i = 0; i < 500; ++i) {
        const size_t bytes = kTileBytes + static_cast<size_t>(t) * 4096;
        auto* const block = static_cast<unsigned char*>(AllocateLargeBlock(bytes));
        ASSERT_NE(block, nullptr);
        block[0] = block[bytes - 1] = static_cast<unsigned char>(t);
        if (i % 16 == 0) TrimLargeBlocks();
        ASSERT_EQ(block[0], t);
        ASSERT_EQ(block[bytes - 1], t);
        FreeLargeBlock(block);
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
}

}  // namespace
}  // namespace tessera
