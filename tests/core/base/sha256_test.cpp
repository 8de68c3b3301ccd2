#include "core/base/sha256.h"

#include <gtest/gtest.h>

#include <fstream>

namespace tessera {
namespace {

// The examples of FIPS 180-4.
TEST(Sha256Test, KnownDigests) {
  EXPECT_EQ(ToHex(Sha256Of("")),
            "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
  EXPECT_EQ(ToHex(Sha256Of("abc")),
            "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
  EXPECT_EQ(ToHex(Sha256Of(std::string(1000000, 'a'))),
            "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0");
}

TEST(Sha256Test, PiecesGiveTheDigestOfTheWhole) {
  Sha256 pieces;
  pieces.Update("a");
  pieces.Update("");
  pieces.Update("bc");
  EXPECT_EQ(pieces.Finish(), Sha256Of("abc"));
}

TEST(Sha256Test, BytesRoundTrip) {
  const Sha256Digest digest = Sha256Of("abc");
  EXPECT_EQ(*Sha256FromBytes(ToBytes(digest)), digest);
  EXPECT_EQ(Sha256FromBytes("short").status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(Sha256FromBytes(ToBytes(digest) + "x").status().code(),
            absl::StatusCode::kInvalidArgument);
}

TEST(Sha256Test, Files) {
  const std::string path = testing::TempDir() + "/sha256_test";
  std::ofstream(path, std::ios::binary) << "abc";
  EXPECT_EQ(*Sha256OfFile(path), Sha256Of("abc"));
  const absl::Status missing = Sha256OfFile(path + ".missing").status();
  EXPECT_EQ(missing.code(), absl::StatusCode::kNotFound);
  EXPECT_NE(missing.message().find(path), absl::string_view::npos);
}

}  // namespace
}  // namespace tessera
