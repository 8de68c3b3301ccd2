#include "client/cli/connect.h"

#include <algorithm>
#include <fstream>
#include <iterator>

#include <grpc/grpc.h>
#include <grpcpp/create_channel.h>
#include <grpcpp/security/credentials.h>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"

namespace tessera {
namespace {

constexpr int kKeepaliveMs = 20000;         // a silent connection is probed
constexpr int kKeepaliveTimeoutMs = 10000;  // and given up
constexpr int kReconnectMinMs = 100;
constexpr int kReconnectMaxMs = 2000;
constexpr int kReceiveBytesMax = 16 << 20;  // a film node of the largest tile
constexpr size_t kCredentialBytesMax = 1 << 20;

std::string HostOf(const std::string& address) {
  return address.substr(0, address.rfind(':'));
}

absl::Status CheckAddress(const std::string& address) {
  const auto bad = [&address](const std::string& why) {
    return absl::InvalidArgumentError(absl::StrCat(
        "--server ", address, ": ", why, ": give HOST:PORT such as 127.0.0.1:4242 or [::1]:4242"));
  };
  if (absl::StrContains(address, "://")) return bad("is a URL");
  if (address.back() == ']' || !absl::StrContains(address, ':')) return bad("names no port");
  const std::string host = HostOf(address);
  const bool bracketed = host.size() > 2 && host.front() == '[' && host.back() == ']';
  if (!bracketed && absl::StrContains(host, ':')) return bad("an IPv6 address needs brackets");
  int port = 0;
  if (!absl::SimpleAtoi(address.substr(host.size() + 1), &port) || port < 1 || port > 65535) {
    return bad("its port is no number from 1 to 65535");
  }
  const auto is_name = [](char c) { return absl::ascii_isgraph(static_cast<unsigned char>(c)); };
  if (host.empty() || !std::ranges::all_of(host, is_name) || absl::StrContains(host, '/') ||
      (!bracketed && host.find_first_of("[]") != std::string::npos)) {
    return bad("names no host");
  }
  return absl::OkStatus();
}

absl::StatusOr<std::string> ReadCredential(const std::string& flag, const std::string& path) {
  if (path.empty()) return std::string();
  std::ifstream file(path, std::ios::binary);
  std::string bytes{std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
  if (!file.is_open() || bytes.empty() || bytes.size() > kCredentialBytesMax) {
    return absl::InvalidArgumentError(
        absl::StrCat(flag, " ", path, ": cannot be read or is empty: check the path"));
  }
  return bytes;
}

grpc::ChannelArguments ChannelArgs(bool loopback) {
  grpc::ChannelArguments args;
  args.SetInt(GRPC_ARG_KEEPALIVE_TIME_MS, kKeepaliveMs);
  args.SetInt(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, kKeepaliveTimeoutMs);
  args.SetInt(GRPC_ARG_INITIAL_RECONNECT_BACKOFF_MS, kReconnectMinMs);
  args.SetInt(GRPC_ARG_MIN_RECONNECT_BACKOFF_MS, kReconnectMinMs);
  args.SetInt(GRPC_ARG_MAX_RECONNECT_BACKOFF_MS, kReconnectMaxMs);
  args.SetMaxReceiveMessageSize(kReceiveBytesMax);
  if (loopback) args.SetInt(GRPC_ARG_ENABLE_HTTP_PROXY, 0);
  return args;
}

}  // namespace

bool IsLoopback(const std::string& address) {
  const std::string host = HostOf(address);
  // A name may begin with 127. too: only numbers are this machine's.
  return host == "localhost" || host == "[::1]" ||
         (absl::StartsWith(host, "127.") &&
          host.find_first_not_of("0123456789.") == std::string::npos);
}

absl::StatusOr<Connection> Connect(const ConnectFlags& flags) {
  if (flags.server.empty()) {
    return absl::InvalidArgumentError(
        "--server: this command asks a server: name it with --server HOST:PORT");
  }
  const absl::Status address = CheckAddress(flags.server);
  if (!address.ok()) return address;
  const bool tls = !flags.ca.empty() || !flags.cert.empty() || !flags.key.empty();
  if (tls && flags.insecure) {
    return absl::InvalidArgumentError(
        "--insecure: cannot be combined with --ca, --cert, --key; drop one of them");
  }
  if (flags.cert.empty() != flags.key.empty()) {
    return absl::InvalidArgumentError("--cert and --key belong together: give both");
  }
  const bool loopback = IsLoopback(flags.server);
  if (!tls && !loopback && !flags.insecure) {
    return absl::InvalidArgumentError(absl::StrCat(
        "--server ", flags.server, ": plaintext would leave this machine: give --ca for TLS, or "
        "--insecure if you trust the network"));
  }

  Connection connection;
  connection.options.address = flags.server;
  connection.options.tls = tls;
  absl::StatusOr<std::string> token = ReadCredential("--token-file", flags.token_file);
  if (!token.ok()) return token.status();
  connection.options.token = std::string(absl::StripAsciiWhitespace(*token));

  std::shared_ptr<grpc::ChannelCredentials> credentials = grpc::InsecureChannelCredentials();
  if (tls) {
    grpc::SslCredentialsOptions options;
    for (const auto& [flag, path, target] :
         {std::tuple{"--ca", &flags.ca, &options.pem_root_certs},
          std::tuple{"--cert", &flags.cert, &options.pem_cert_chain},
          std::tuple{"--key", &flags.key, &options.pem_private_key}}) {
      absl::StatusOr<std::string> bytes = ReadCredential(flag, *path);
      if (!bytes.ok()) return bytes.status();
      *target = *std::move(bytes);
    }
    credentials = grpc::SslCredentials(options);
  }
  connection.channel = grpc::CreateCustomChannel(flags.server, credentials, ChannelArgs(loopback));
  return connection;
}

}  // namespace tessera
