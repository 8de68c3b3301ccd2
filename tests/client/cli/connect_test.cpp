#include "client/cli/connect.h"

#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "proto/channel/server_address.h"
#include "tests/client/temporary_folder.h"

namespace tessera {
namespace {

using ::testing::HasSubstr;

std::string ErrorOf(const ConnectFlags& flags) {
  const auto connection = Connect(flags);
  EXPECT_TRUE(absl::IsInvalidArgument(connection.status()));
  return std::string(connection.status().message());
}

TEST(Connect, LoopbackNeedsNothing) {
  for (const char* address : {"127.0.0.1:4242", "localhost:1", "[::1]:4242", "127.1.2.3:9"}) {
    EXPECT_TRUE(IsLoopback(address)) << address;
    EXPECT_TRUE(Connect({.server = address}).ok()) << address;
  }
}

TEST(Connect, PlaintextLeavesThisMachineOnlyWithInsecure) {
  EXPECT_FALSE(IsLoopback("farm.example:4242"));
  EXPECT_FALSE(IsLoopback("128.0.0.1:4242"));
  EXPECT_FALSE(IsLoopback("127.farm.example:4242"));
  EXPECT_THAT(ErrorOf({.server = "farm.example:4242"}), HasSubstr("--insecure"));
  EXPECT_TRUE(Connect({.server = "farm.example:4242", .security = {.insecure = true}}).ok());
}

TEST(Connect, BadAddressesAndCombinations) {
  for (const char* address : {"farm", "farm:", ":4242", "farm:0", "farm:65536", "farm:x"}) {
    EXPECT_THAT(ErrorOf({.server = address}), HasSubstr("HOST:PORT")) << address;
  }
  for (const char* address : {"[::1]", "10.0.0.7", "farm"}) {
    EXPECT_THAT(ErrorOf({.server = address}), HasSubstr("names no port")) << address;
  }
  for (const char* address : {"::1:4242", "fe80::1:4242", "::1"}) {
    EXPECT_THAT(ErrorOf({.server = address}), HasSubstr("needs brackets")) << address;
  }
  for (const char* address : {"farm/x:4242", "two words:4242", "[]:4242", ":4242"}) {
    EXPECT_THAT(ErrorOf({.server = address}), HasSubstr("HOST:PORT")) << address;
  }
  EXPECT_THAT(ErrorOf({.server = "https://farm:4242"}), HasSubstr("URL"));
  EXPECT_THAT(ErrorOf({}), HasSubstr("--server"));
  const ConnectFlags cert_only = {.server = "127.0.0.1:1", .security = {.cert = "c.pem"}};
  EXPECT_THAT(ErrorOf(cert_only), HasSubstr("--cert and --key"));
  const ConnectFlags both = {.server = "127.0.0.1:1",
                             .security = {.ca = "c.pem", .insecure = true}};
  EXPECT_THAT(ErrorOf(both), HasSubstr("--insecure"));
  const ConnectFlags no_file = {.server = "127.0.0.1:1",
                                .security = {.ca = "/nonexistent.pem"}};
  EXPECT_THAT(ErrorOf(no_file), HasSubstr("--ca /nonexistent.pem"));
}

TEST(Connect, TokenIsReadWithoutItsLineEnd) {
  const TemporaryFolder folder;
  const ConnectFlags flags = {.server = "127.0.0.1:1",
                              .security = {.token_file = folder.Write("token", "secret\n")}};
  const auto connection = Connect(flags);
  ASSERT_TRUE(connection.ok()) << connection.status();
  EXPECT_EQ(connection->options.token, "secret");
  const ConnectFlags empty = {.server = "127.0.0.1:1",
                              .security = {.token_file = folder.Write("none", "")}};
  EXPECT_THAT(ErrorOf(empty), HasSubstr("--token-file"));
  const ConnectFlags list = {.server = "127.0.0.1:1",
                             .security = {.token_file = folder.Write("list", "view me abc\n")}};
  EXPECT_THAT(ErrorOf(list), HasSubstr("more than one word"));
}

}  // namespace
}  // namespace tessera
