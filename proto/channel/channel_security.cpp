#include "proto/channel/channel_security.h"

#include <fstream>
#include <iterator>
#include <tuple>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "proto/channel/server_address.h"

namespace tessera {
namespace {

constexpr std::streamsize kCredentialBytesMax = 1 << 20;

absl::StatusOr<std::string> ReadCredential(const std::string& flag, const std::string& path) {
  if (path.empty()) return std::string();
  std::ifstream file(path, std::ios::binary);
  std::string bytes(kCredentialBytesMax + 1, '\0');
  file.read(bytes.data(), std::ssize(bytes));
  bytes.resize(static_cast<size_t>(file.gcount()));
  if (bytes.empty() || std::ssize(bytes) > kCredentialBytesMax) {
    return absl::InvalidArgumentError(
        absl::StrCat(flag, " ", path, ": cannot be read or is empty: check the path"));
  }
  return bytes;
}

}  // namespace

absl::StatusOr<ChannelSecurity> ReadChannelSecurity(const std::string& address,
                                                    const SecurityFlags& flags) {
  if (absl::Status status = CheckServerAddress(address); !status.ok()) return status;
  ChannelSecurity security;
  security.tls = !flags.ca.empty() || !flags.cert.empty() || !flags.key.empty();
  if (security.tls && flags.insecure) {
    return absl::InvalidArgumentError(
        "--insecure: cannot be combined with --ca, --cert, --key; drop one of them");
  }
  if (flags.cert.empty() != flags.key.empty()) {
    return absl::InvalidArgumentError("--cert and --key belong together: give both");
  }
  if (!security.tls && !IsLoopback(address) && !flags.insecure) {
    return absl::InvalidArgumentError(absl::StrCat(
        "--server ", address, ": plaintext would leave this machine: give --ca for TLS, or "
        "--insecure if you trust the network"));
  }
  const absl::StatusOr<std::string> token = ReadCredential("--token-file", flags.token_file);
  if (!token.ok()) return token.status();
  security.token = std::string(absl::StripAsciiWhitespace(*token));
  for (const char c : security.token) {
    if (!absl::ascii_isgraph(static_cast<unsigned char>(c))) {
      return absl::InvalidArgumentError(absl::StrCat(
          "--token-file ", flags.token_file, ": holds more than one word: it must be the token "
          "alone, not the server's list"));
    }
  }
  if (!security.tls) return security;
  grpc::SslCredentialsOptions options;
  for (const auto& [flag, path, target] :
       {std::tuple{"--ca", &flags.ca, &options.pem_root_certs},
        std::tuple{"--cert", &flags.cert, &options.pem_cert_chain},
        std::tuple{"--key", &flags.key, &options.pem_private_key}}) {
    absl::StatusOr<std::string> bytes = ReadCredential(flag, *path);
    if (!bytes.ok()) return bytes.status();
    *target = *std::move(bytes);
  }
  security.credentials = grpc::SslCredentials(options);
  return security;
}

}  // namespace tessera
