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

TEST_P(AssetStoreTest, AJobsAssetsMakeRoomOnceNoJobNeedsThem) {
  Open(10);
  ASSERT_TRUE(Put("shared").ok());
  ASSERT_TRUE(Put("own").ok());
  ASSERT_TRUE(store_->Reference(1, {Sha256Of("shared"), Sha256Of("own")}).ok());
  ASSERT_TRUE(store_->Reference(2, {Sha256Of("shared")}).ok());
  const absl::Status missing = store_->Reference(3, {Sha256Of("absent")});
  EXPECT_TRUE(absl::IsFailedPrecondition(missing));
  EXPECT_NE(missing.message().find(ToHex(Sha256Of("absent"))), absl::string_view::npos);
  store_->Release(1);
  EXPECT_TRUE(store_->Has(Sha256Of("own"))) << "another client may count on it";
  ASSERT_TRUE(Put("next").ok());
  EXPECT_TRUE(store_->Has(Sha256Of("shared")));
  EXPECT_FALSE(store_->Has(Sha256Of("own")));
  store_->Release(2);
  ASSERT_TRUE(Put("last").ok());
  EXPECT_FALSE(store_->Has(Sha256Of("shared")));
}

// FindMissing has told a client that it need not send what another client's job releases then.
TEST_P(AssetStoreTest, WhatWasAskedForOutlivesTheJobThatHadIt) {
  Open(12);
  ASSERT_TRUE(Put("aaaa").ok());
  ASSERT_TRUE(Put("bbbb").ok());
  ASSERT_TRUE(store_->Reference(1, {Sha256Of("aaaa")}).ok());
  EXPECT_EQ(store_->ReceivedBytes(Sha256Of("aaaa")), 4);
  store_->Release(1);
  ASSERT_TRUE(Put("cccc").ok());
  ASSERT_TRUE(Put("dddd").ok()) << "takes the room of what was used longest ago";
  EXPECT_FALSE(store_->Has(Sha256Of("bbbb")));
  EXPECT_TRUE(store_->Reference(2, {Sha256Of("aaaa")}).ok());
}

TEST_P(AssetStoreTest, AnOpenFileStays) {
  Open(10);
  ASSERT_TRUE(Put("aaaa").ok());
  {
    const absl::StatusOr<StoredFile> file = store_->OpenFile(Sha256Of("aaaa"));
    ASSERT_TRUE(file.ok());
    (void)Put("0123456789");  // needs all the room that there is
    std::ifstream reader(file->path());
    std::string bytes;
    EXPECT_TRUE(reader >> bytes);
    EXPECT_EQ(bytes, "aaaa");
  }
  EXPECT_TRUE(Put("0123456789").ok()) << "the room of a file that was closed";
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

TEST_P(AssetStoreTest, AFileThatTheDiskHasDamagedIsUploadedAgain) {
  if (!GetParam()) GTEST_SKIP() << "memory has no files";
  const std::string bytes = "hello, world";
  const Sha256Digest digest = Sha256Of(bytes);
  for (const bool by_reading : {false, true}) {
    ASSERT_TRUE(Put(bytes).ok());
    store_.reset();
    std::ofstream(dir_ + "/" + ToHex(digest)) << "hello, wOrld";
    Open(0);
    ASSERT_TRUE(store_->Reference(7, {digest}).ok()) << "nobody has looked at it yet";
    if (by_reading) {
      const absl::Status status = store_->Read(digest, 0, 100).status();
      EXPECT_TRUE(absl::IsDataLoss(status)) << status;
      EXPECT_NE(status.message().find("uploads it again"), absl::string_view::npos);
    }
    EXPECT_FALSE(store_->Has(digest));
    EXPECT_EQ(store_->ReceivedBytes(digest), 0);
    EXPECT_EQ(store_->bytes(), 0);
    EXPECT_TRUE(absl::IsFailedPrecondition(store_->CheckPresent({digest})));
    ASSERT_TRUE(Put(bytes).ok());
    EXPECT_TRUE(store_->Has(digest));
    EXPECT_EQ(*store_->Read(digest, 0, 100), bytes);
    EXPECT_EQ(store_->bytes(), 12);
    store_->Release(7);
  }
}

TEST_P(AssetStoreTest, AFileThatIsCutOrGoneIsUploadedAgain) {
  if (!GetParam()) GTEST_SKIP() << "memory has no files";
  const std::string bytes = "hello, world";
  const Sha256Digest digest = Sha256Of(bytes);
  ASSERT_TRUE(Put(bytes).ok());
  std::filesystem::resize_file(dir_ + "/" + ToHex(digest), 5);  // it was whole when it came
  EXPECT_TRUE(absl::IsDataLoss(store_->Read(digest, 0, 100).status()));
  ASSERT_TRUE(Put(bytes).ok());
  store_.reset();
  Open(0);
  std::filesystem::remove(dir_ + "/" + ToHex(digest));
  EXPECT_TRUE(absl::IsDataLoss(store_->OpenFile(digest).status()));
  ASSERT_TRUE(Put(bytes).ok());
  EXPECT_EQ(*store_->Read(digest, 0, 100), bytes);
}

}  // namespace
}  // namespace tessera
