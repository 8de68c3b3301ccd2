// Pictures and job states over HTTP, for browsers and scripts: / (thumbnails), /healthz, /jobs,
// /jobs/N, /jobs/N/image.png?layer=&region=X,Y,W,H&exposure=EV with an ETag. Read-only.
#pragma once

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "server/coordinator_host.h"
#include "server/picture/picture_service.h"

namespace tessera {

// Threads: all methods from any thread.
class HttpServer {
 public:
  // address: "HOST:PORT", port 0 = any. `host` and `pictures` must outlive the server.
  // Errors: INVALID_ARGUMENT (not an address), UNAVAILABLE (in use).
  static absl::StatusOr<std::unique_ptr<HttpServer>> Start(const std::string& address,
                                                           CoordinatorHost& host,
                                                           PictureService& pictures);
  ~HttpServer();  // Stop

  int port() const;
  void Stop();  // idempotent

 private:
  class Impl;
  explicit HttpServer(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace tessera
