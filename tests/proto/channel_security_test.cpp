#include "proto/channel/channel_security.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "proto/channel/server_address.h"

namespace tessera {
namespace {

using ::testing::HasSubstr;

std::string ErrorOf(const std::string& address, const SecurityFlags& flags) {
  const auto security = ReadChannelSecurity(address, flags);
  EXPECT_TRUE(absl::IsInvalidArgument(security.status())) << security.status();
  return std::string(security.status().message());
}

TEST(ServerAddress, NeedsHostAndPort) {
  for (const char* good : {"127.0.0.1:1", "localhost:65535", "[::1]:4242", "render.example:80"}) {
    EXPECT_TRUE(CheckServerAddress(good).ok()) << good;
  }
  for (const char* wrong : {"", ":", "localhost", "localhost:", ":4242", "localhost:0",
                            "localhost:65536", "localhost:x", "localhost:4242x", "::1:4242"}) {
    EXPECT_FALSE(CheckServerAddress(wrong).ok()) << wrong;
  }
}

TEST(ServerAddress, OnlyNumbersOfThisMachineAreLoopback) {
  for (const char* here : {"127.0.0.1:0", "127.8.9.1:80", "localhost:1", "[::1]:1", "unix:/a"}) {
    EXPECT_TRUE(IsLoopback(here)) << here;
  }
  for (const char* away : {"127.farm.example:1", "10.0.0.1:1", "[fe80::1]:1", "localhost.x:1"}) {
    EXPECT_FALSE(IsLoopback(away)) << away;
  }
}

TEST(ChannelSecurity, PlaintextStaysOnTheMachineUnlessToldOtherwise) {
  EXPECT_FALSE(ReadChannelSecurity("127.0.0.1:1", {})->tls);
  EXPECT_THAT(ErrorOf("render.example:4242", {}), HasSubstr("--ca"));
  EXPECT_TRUE(ReadChannelSecurity("render.example:4242", {.insecure = true}).ok());
}

TEST(ChannelSecurity, FlagsThatContradict) {
  EXPECT_THAT(ErrorOf("127.0.0.1:1", {.cert = "c.pem"}), HasSubstr("--cert and --key"));
  EXPECT_THAT(ErrorOf("127.0.0.1:1", {.ca = "c.pem", .insecure = true}), HasSubstr("--insecure"));
  EXPECT_THAT(ErrorOf("127.0.0.1:1", {.ca = "/nonexistent.pem"}),
              HasSubstr("--ca /nonexistent.pem"));
}

}  // namespace
}  // namespace tessera
