#include "server/security/tls.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/server/security/temporary_certificates.h"

namespace tessera {
namespace {

using ::testing::HasSubstr;

class TlsTest : public testing::Test {
 protected:
  std::string ErrorOf(const TlsFiles& files) {
    const auto credentials = MakeServerCredentials(files);
    EXPECT_TRUE(absl::IsInvalidArgument(credentials.status())) << credentials.status();
    return std::string(credentials.status().message());
  }
  TemporaryCertificates files_;
  const std::string cert_ = files_.Path("server.pem");
  const std::string key_ = files_.Path("server.key");
};

TEST_F(TlsTest, PairsThatFit) {
  EXPECT_TRUE(MakeServerCredentials({}).ok());
  EXPECT_TRUE(MakeServerCredentials({.cert = cert_, .key = key_}).ok());
  EXPECT_TRUE(
      MakeServerCredentials({.cert = cert_, .key = key_, .client_ca = files_.Path("ca.pem")}).ok());
}

TEST_F(TlsTest, WhatIsWrongIsSaid) {
  EXPECT_THAT(ErrorOf({.cert = cert_}), HasSubstr("give both"));
  EXPECT_THAT(ErrorOf({.client_ca = files_.Path("ca.pem")}), HasSubstr("--client-ca needs TLS"));
  EXPECT_THAT(ErrorOf({.cert = files_.Path("none"), .key = key_}), HasSubstr("cannot be read"));
  EXPECT_THAT(ErrorOf({.cert = key_, .key = key_}), HasSubstr("no PEM certificate"));
  EXPECT_THAT(ErrorOf({.cert = cert_, .key = cert_}), HasSubstr("no PEM key"));
  EXPECT_THAT(ErrorOf({.cert = cert_, .key = files_.Path("worker.key")}),
              HasSubstr("is not the key of"));
  EXPECT_THAT(ErrorOf({.cert = cert_, .key = key_, .client_ca = key_}), HasSubstr("--client-ca"));
}

TEST_F(TlsTest, ExpiredCertificatesAreRefusedAtTheStart) {
  files_.Certificate("old", "ca", -1, "subjectAltName=DNS:localhost");
  EXPECT_THAT(ErrorOf({.cert = files_.Path("old.pem"), .key = files_.Path("old.key")}),
              HasSubstr("has expired"));
}

}  // namespace
}  // namespace tessera
