// The channel of a worker to its server.
#pragma once

#include <grpcpp/channel.h>

#include <memory>
#include <string>

#include "proto/channel/channel_security.h"

namespace tessera {

// Notices dead links, lets the session decide when to try again, and sends the token of `security`
// with each call. `address`: "HOST:PORT".
std::shared_ptr<grpc::Channel> MakeWorkerChannel(const std::string& address,
                                                 const ChannelSecurity& security = {});

}  // namespace tessera
