#include "server/store/asset_store.h"

#include <filesystem>
#include <fstream>

#include <gtest/gtest.h>

namespace tessera {
namespace {

// Every test runs on disk and in memory.
class AssetStoreTest : public testing::TestWithParam<bool> {
 protected:
  void SetUp() override {
    dir_ = testing::TempDir() + "/assets-" + std::to_string(::getpid());
    std::filesystem::remove_all(dir_);
    Open(0);
  }
  void TearDown() override { std::filesystem::remove_all(dir_); }
  void Open(int64_t bytes_max) {
    store_ = *AssetStore::Open(GetParam() ? dir_ : "", bytes_max);
  }
  absl::StatusOr<int64_t> Put(const std::string& bytes) {
    return store_->Append(Sha256Of(bytes), static_cast<int64_t>(bytes.size()), 0, bytes);
  }
  std::string dir_;
  std::unique_ptr<AssetStore> store_;
};

TEST_P(AssetStoreTest, KeepsWhatMatchesItsDigest) {
  const std::string bytes = "hello, world";
  const Sha256Digest digest = Sha256Of(bytes);
  EXPECT_FALSE(store_->Has(digest));
  EXPECT_EQ(*store_->Append(digest, 12, 0, "hello"), 5);
  EXPECT_EQ(store_->ReceivedBytes(digest), 5);
  EXPECT_TRUE(absl::IsOutOfRange(store_->Append(digest, 12, 7, "world").status()));
  EXPECT_EQ(*store_->Append(digest, 12, 3, "lo, world"), 12) << "an overlap is skipped";
  EXPECT_TRUE(store_->Has(digest));
  EXPECT_EQ(*store_->Read(digest, 7, 100), "world");
  EXPECT_EQ(*store_->Read(digest, 12, 100), "");
  EXPECT_TRUE(absl::IsOutOfRange(store_->Read(digest, 13, 1).status()));
  std::ifstream file(store_->OpenFile(digest)->path());
  EXPECT_EQ(store_->bytes(), 12);
}

TEST_P(AssetStoreTest, DropsWrongBytes) {
  const Sha256Digest digest = Sha256Of("right");
  EXPECT_TRUE(absl::IsDataLoss(store_->Append(digest, 5, 0, "wrong").status()));
  EXPECT_EQ(store_->ReceivedBytes(digest), 0);
  EXPECT_EQ(store_->bytes(), 0);
  EXPECT_TRUE(absl::IsInvalidArgument(store_->Append(digest, 5, 0, "too long").status()));
  EXPECT_EQ(*store_->Append(digest, 5, 0, "right"), 5);
}

TEST_P(AssetStoreTest, KeepsTheEmptyFile) {
  EXPECT_TRUE(Put("").ok());
  EXPECT_TRUE(store_->Has(Sha256Of("")));
}

TEST_P(AssetStoreTest, MakesRoomOnlyFromWhatNoJobNeeds) {
  Open(10);
  ASSERT_TRUE(Put("aaaa").ok());
  ASSERT_TRUE(Put("bbbb").ok());
  ASSERT_TRUE(store_->Reference(1, {Sha256Of("aaaa")}).ok());
  ASSERT_TRUE(Put("cccc").ok());
  EXPECT_TRUE(store_->Has(Sha256Of("aaaa")));
  EXPECT_FALSE(store_->Has(Sha256Of("bbbb")));
  EXPECT_TRUE(absl::IsResourceExhausted(Put("0123456789").status()));
  EXPECT_LE(store_->bytes(), 10);
}

TEST_P(AssetStoreTest, AJobsAssetsGoWithTheLastJobThatNeedsThem) {
  ASSERT_TRUE(Put("shared").ok());
  ASSERT_TRUE(Put("own").ok());
  ASSERT_TRUE(store_->Reference(1, {Sha256Of("shared"), Sha256Of("own")}).ok());
  ASSERT_TRUE(store_->Reference(2, {Sha256Of("shared")}).ok());
  const absl::Status missing = store_->Reference(3, {Sha256Of("absent")});
  EXPECT_TRUE(absl::IsFailedPrecondition(missing));
  EXPECT_NE(missing.message().find(ToHex(Sha256Of("absent"))), absl::string_view::npos);
  store_->Release(1);
  EXPECT_TRUE(store_->Has(Sha256Of("shared")));
  EXPECT_FALSE(store_->Has(Sha256Of("own")));
  store_->Release(2);
  EXPECT_EQ(store_->bytes(), 0);
}

TEST_P(AssetStoreTest, AnUploadResumesAfterARestart) {
  if (!GetParam()) GTEST_SKIP() << "memory does not survive";
  const std::string bytes(100000, 'x');
  const Sha256Digest digest = Sha256Of(bytes);
  ASSERT_TRUE(store_->Append(digest, 100000, 0, bytes.substr(0, 60000)).ok());
  ASSERT_TRUE(Put("done").ok());
  store_.reset();
  Open(0);
  EXPECT_TRUE(store_->Has(Sha256Of("done")));
  EXPECT_EQ(store_->ReceivedBytes(digest), 60000);
  EXPECT_EQ(*store_->Append(digest, 100000, 60000, bytes.substr(60000)), 100000);
  EXPECT_EQ(*store_->Read(digest, 0, 1 << 20), bytes);
}

TEST_P(AssetStoreTest, AbandonedUploadsDoNotShutTheStore) {
  for (int i = 0; i < 5000; ++i) {
    const Sha256Digest digest = Sha256Of(std::to_string(i));
    EXPECT_TRUE(absl::IsOutOfRange(store_->Append(digest, 9, 5, "x").status()));
    EXPECT_TRUE(store_->Append(digest, 9, 0, "x").ok());
  }
  EXPECT_LE(store_->bytes(), 4096) << "those that were begun first are dropped";
  EXPECT_EQ(store_->ReceivedBytes(Sha256Of("4999")), 1);
  EXPECT_TRUE(Put("a scene").ok());
}

INSTANTIATE_TEST_SUITE_P(Places, AssetStoreTest, testing::Bool(),
                         [](const auto& place) { return place.param ? "Disk" : "Memory"; });

}  // namespace
}  // namespace tessera
