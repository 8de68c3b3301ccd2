// How a client or a worker proves who it is, and whom it trusts.
#pragma once

#include <memory>
#include <string>

#include <grpcpp/security/credentials.h>

#include "absl/status/statusor.h"

namespace tessera {

// Of the flags --ca, --cert, --key, --token-file and --insecure; empty = not given.
struct SecurityFlags {
  std::string ca{};    // PEM: whom to trust; without it the system's authorities
  std::string cert{};  // PEM: this side's certificate, for mutual TLS
  std::string key{};   // PEM: its private key
  std::string token_file{};
  bool insecure = false;
};

// As it stands: plaintext, no token.
struct ChannelSecurity {
  std::shared_ptr<grpc::ChannelCredentials> credentials = grpc::InsecureChannelCredentials();
  std::string token;  // travels with each call as "authorization: Bearer TOKEN"; empty = none
  bool tls = false;
};

// Reads what the flags name. --ca, --cert or --key ask for TLS; plaintext goes to this machine
// only, unless --insecure. `address`: of the server, "HOST:PORT".
// Errors: INVALID_ARGUMENT naming the flag and the remedy.
absl::StatusOr<ChannelSecurity> ReadChannelSecurity(const std::string& address,
                                                    const SecurityFlags& flags);

}  // namespace tessera
