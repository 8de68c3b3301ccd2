// A stream that ends at once.
#pragma once

#include <grpcpp/support/server_callback.h>

#include "server/rpc/rpc_status.h"

namespace tessera {

// Reactor: one of gRPC's server reactors of streams. Deletes itself.
template <typename Reactor>
class RefusedStream final : public Reactor {
 public:
  explicit RefusedStream(const absl::Status& status) { this->Finish(ToGrpc(status)); }
  void OnDone() override { delete this; }
};

}  // namespace tessera
