#include "worker/session/host_resources.h"

#include <gtest/gtest.h>

#include "worker/session/asset_cache.h"
#include "worker/session/backoff.h"

namespace tessera {
namespace {

TEST(HostResources, ByteSizes) {
  EXPECT_EQ(ParseByteSize("0").value(), 0);
  EXPECT_EQ(ParseByteSize("1073741824").value(), int64_t{1} << 30);
  EXPECT_EQ(ParseByteSize("512M").value(), int64_t{512} << 20);
  EXPECT_EQ(ParseByteSize("8G").value(), int64_t{8} << 30);
  EXPECT_EQ(ParseByteSize("8GiB").value(), int64_t{8} << 30);
  EXPECT_EQ(ParseByteSize("8gB").value(), int64_t{8} << 30);
  EXPECT_EQ(ParseByteSize("1.5T").value(), int64_t{3} << 39);
  EXPECT_EQ(ParseByteSize("100B").value(), 100);
  for (const char* wrong : {"", "G", "-1", "8X", "8 G", "1e9", "nan", "inf", "9999999T", "8Gx"}) {
    EXPECT_FALSE(ParseByteSize(wrong).ok()) << wrong;
  }
}

TEST(HostResources, AreThere) {
  EXPECT_GE(MachineThreads(), 1);
  EXPECT_GT(MachineMemoryBytes(), 0);
  EXPECT_FALSE(MachineName().empty());
}

Blob BlobOf(size_t size) { return std::make_shared<const std::string>(size, 'x'); }

TEST(AssetCache, KeepsTheMostRecentlyUsedWithinTheLimit) {
  AssetCache cache(100);
  const Sha256Digest a = Sha256Of("a"), b = Sha256Of("b"), c = Sha256Of("c");
  cache.Add(a, BlobOf(40));
  cache.Add(b, BlobOf(40));
  EXPECT_NE(cache.Find(a), nullptr);
  cache.Add(c, BlobOf(40));
  EXPECT_EQ(cache.bytes(), 80);
  EXPECT_NE(cache.Find(a), nullptr);
  EXPECT_EQ(cache.Find(b), nullptr);
  EXPECT_NE(cache.Find(c), nullptr);
  cache.Add(b, BlobOf(101));
  EXPECT_EQ(cache.Find(b), nullptr) << "larger than the whole cache";
  EXPECT_EQ(cache.bytes(), 80);
  cache.Add(b, BlobOf(100));
  EXPECT_EQ(cache.bytes(), 100);
}

TEST(Backoff, DoublesWithinItsBoundsAndDiffersBetweenWorkers) {
  using std::chrono::milliseconds;
  Backoff one(milliseconds(100), milliseconds(3000), 1);
  Backoff two(milliseconds(100), milliseconds(3000), 2);
  bool differ = false;
  for (int i = 0; i < 40; ++i) {
    const milliseconds wait = one.Next();
    const milliseconds full(i < 5 ? 100 << i : 3000);
    EXPECT_GE(wait, full / 2);
    EXPECT_LT(wait, full);
    differ |= wait != two.Next();
  }
  EXPECT_TRUE(differ);
  one.Reset();
  EXPECT_LT(one.Next(), milliseconds(100));
}

}  // namespace
}  // namespace tessera
