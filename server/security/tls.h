// The server's side of TLS.
#pragma once

#include <memory>
#include <string>

#include <grpcpp/security/server_credentials.h>

#include "absl/status/statusor.h"

namespace tessera {

// PEM files; all empty = plaintext.
struct TlsFiles {
  std::string cert{};       // the server's certificate chain
  std::string key{};        // its private key
  std::string client_ca{};  // whose certificates workers need; empty = none are asked for

  bool enabled() const { return !cert.empty(); }
};

// Plaintext credentials if no file is named. Files are read once: new ones need a restart.
// Errors: INVALID_ARGUMENT naming the flag, what is wrong (unreadable, not PEM, key of another
// certificate, expired or not yet valid) and the remedy.
absl::StatusOr<std::shared_ptr<grpc::ServerCredentials>> MakeServerCredentials(
    const TlsFiles& files);

}  // namespace tessera
