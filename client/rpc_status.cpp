#include "client/rpc_status.h"

#include "absl/strings/str_cat.h"

namespace tessera {
namespace {

std::string UnavailableLine(const grpc::Status& status, const Peer& peer) {
  if (peer.address.empty()) {
    return absl::StrCat("the coordinator inside this process stopped: ", status.error_message());
  }
  if (status.error_code() == grpc::StatusCode::DEADLINE_EXCEEDED) {
    return absl::StrCat("the server at ", peer.address,
                        " did not answer in time: check its load and the network, then repeat");
  }
  if (peer.reached) {
    return absl::StrCat("lost the server at ", peer.address, " (", status.error_message(),
                        "): once it is back, 'tessera list --server ", peer.address,
                        "' shows its jobs");
  }
  if (peer.tls) {
    return absl::StrCat("no TLS server at ", peer.address, " (", status.error_message(),
                        "): check --ca, --cert and --key, or drop them if it speaks plaintext");
  }
  return absl::StrCat("no server at ", peer.address,
                      ": start one with tessera-server, give --ca if it speaks TLS, or drop "
                      "--server to render here");
}

}  // namespace

bool IsTransient(const grpc::Status& status) {
  return status.error_code() == grpc::StatusCode::UNAVAILABLE ||
         status.error_code() == grpc::StatusCode::DEADLINE_EXCEEDED;
}

absl::Status ToAbslStatus(const grpc::Status& status, const Peer& peer) {
  if (status.ok()) return absl::OkStatus();
  if (IsTransient(status)) return absl::UnavailableError(UnavailableLine(status, peer));
  if (status.error_code() == grpc::StatusCode::UNIMPLEMENTED) {
    return absl::FailedPreconditionError(
        absl::StrCat("what answers at ", peer.address.empty() ? "the channel" : peer.address,
                     " does not know this call (", status.error_message(),
                     "): it is no tessera-server, or one of another version"));
  }
  const auto code = static_cast<absl::StatusCode>(status.error_code());
  return absl::Status(code, status.error_message());
}

}  // namespace tessera
