#include "client/cli/connect.h"

#include <grpc/grpc.h>
#include <grpcpp/create_channel.h>

#include "proto/channel/channel_security.h"
#include "proto/channel/server_address.h"

namespace tessera {
namespace {

constexpr int kKeepaliveMs = 20000;         // a silent connection is probed
constexpr int kKeepaliveTimeoutMs = 10000;  // and given up
constexpr int kReconnectMinMs = 100;
constexpr int kReconnectMaxMs = 2000;
constexpr int kReceiveBytesMax = 16 << 20;  // a film node of the largest tile

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

absl::StatusOr<Connection> Connect(const ConnectFlags& flags) {
  if (flags.server.empty()) {
    return absl::InvalidArgumentError(
        "--server: this command asks a server: name it with --server HOST:PORT");
  }
  const absl::StatusOr<ChannelSecurity> security =
      ReadChannelSecurity(flags.server, flags.security);
  if (!security.ok()) return security.status();
  Connection connection;
  connection.options.address = flags.server;
  connection.options.tls = security->tls;
  connection.options.token = security->token;
  connection.channel = grpc::CreateCustomChannel(flags.server, security->credentials,
                                                 ChannelArgs(IsLoopback(flags.server)));
  return connection;
}

}  // namespace tessera
