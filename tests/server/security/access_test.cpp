#include "server/security/access.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "tests/server/security/temporary_certificates.h"

namespace tessera {
namespace {

using ::testing::HasSubstr;

constexpr char kTokens[] =
    "# for the tests\n"
    "view   lena   0123456789abcdef\n"
    "\n"
    "submit sam    fedcba9876543210\n"
    "admin  ada    aaaaaaaaaaaaaaaa\n"
    "worker rack-1 bbbbbbbbbbbbbbbb\n";

class AccessTest : public testing::Test {
 protected:
  std::string ErrorOf(const std::string& tokens) {
    const auto access = Access::Open(files_.Write("bad", tokens), false);
    EXPECT_TRUE(absl::IsInvalidArgument(access.status())) << access.status();
    return std::string(access.status().message());
  }
  TemporaryCertificates files_;
  Access access_ = *Access::Open(files_.Write("tokens", kTokens), false);
};

TEST_F(AccessTest, NobodyIsAskedWithoutTokens) {
  const auto caller = Access().CheckHeader("", Role::kAdmin);
  ASSERT_TRUE(caller.ok());
  EXPECT_TRUE(caller->MaySteer("anybody"));
}

TEST_F(AccessTest, RolesIncludeThoseBelow) {
  const auto code = [&](const char* token, Role needed) {
    return access_.CheckHeader(absl::StrCat("Bearer ", token), needed).status().code();
  };
  const char* const tokens[] = {"0123456789abcdef", "fedcba9876543210", "aaaaaaaaaaaaaaaa",
                                "bbbbbbbbbbbbbbbb"};
  const Role roles[] = {Role::kView, Role::kSubmit, Role::kAdmin, Role::kWorker};
  for (int has = 0; has < 4; ++has) {
    for (int needed = 0; needed < 4; ++needed) {
      const bool permitted = has == 3 || needed == 3 ? has == needed : has >= needed;
      EXPECT_EQ(code(tokens[has], roles[needed]),
                permitted ? absl::StatusCode::kOk : absl::StatusCode::kPermissionDenied)
          << has << " " << needed;
    }
  }
}

TEST_F(AccessTest, OwnersSteerTheirOwn) {
  const auto sam = access_.CheckHeader("Bearer fedcba9876543210", Role::kSubmit);
  ASSERT_TRUE(sam.ok()) << sam.status();
  EXPECT_TRUE(sam->MaySteer("sam"));
  EXPECT_FALSE(sam->MaySteer("ada"));
  EXPECT_FALSE(sam->MaySteer(""));
  EXPECT_TRUE(access_.CheckHeader("Bearer aaaaaaaaaaaaaaaa", Role::kSubmit)->MaySteer("sam"));
}

TEST_F(AccessTest, HeadersThatAreNoToken) {
  for (const char* header : {"", "Bearer ", "Bearer x", "Basic !", "fedcba9876543210",
                             "bearer fedcba9876543210", "Bearer fedcba9876543210 "}) {
    EXPECT_TRUE(absl::IsUnauthenticated(access_.CheckHeader(header, Role::kView).status()))
        << header;
  }
}

TEST_F(AccessTest, BrowsersSendTheTokenAsAPassword) {
  const std::string header = "Basic " + absl::Base64Escape("anything:0123456789abcdef");
  EXPECT_EQ(access_.CheckHeader(header, Role::kView)->name, "lena");
}

TEST_F(AccessTest, FilesThatAreRefused) {
  EXPECT_THAT(ErrorOf("# none\n"), HasSubstr("names no token"));
  EXPECT_THAT(ErrorOf("view lena short\n"), HasSubstr("line 1: the token has fewer"));
  EXPECT_THAT(ErrorOf("\nroot lena 0123456789abcdef\n"), HasSubstr("line 2: the role is view"));
  EXPECT_THAT(ErrorOf("view lena\n"), HasSubstr("give ROLE NAME TOKEN"));
  EXPECT_THAT(ErrorOf("view lena 0123456789abcdef more\n"), HasSubstr("give ROLE NAME TOKEN"));
  EXPECT_THAT(ErrorOf("view a 0123456789abcdef\nadmin b 0123456789abcdef\n"),
              HasSubstr("line 2: the token is there already"));
  const std::string open_to_all = files_.Write("open", kTokens);
  std::filesystem::permissions(open_to_all, std::filesystem::perms(0644));
  EXPECT_THAT(std::string(Access::Open(open_to_all, false).status().message()),
              HasSubstr("chmod 600"));
  EXPECT_THAT(std::string(Access::Open(files_.Path("none"), false).status().message()),
              HasSubstr("is no file"));
}

}  // namespace
}  // namespace tessera
