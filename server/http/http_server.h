// Pictures and job states over HTTP, for browsers and scripts: / (thumbnails), /healthz, /jobs,
// /jobs/N, /jobs/N/image.png?layer=&region=X,Y,W,H&exposure=EV with an ETag; /metrics for
// Prometheus. Read-only. Where tokens are asked for, all but /healthz needs one of the role view:
// as a bearer token, or as the password of basic authentication, so that browsers ask for it.
#pragma once

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "server/coordinator_host.h"
#include "server/picture/picture_service.h"
#include "server/security/access.h"
#include "server/security/tls.h"

namespace tessera {

// Threads: all methods from any thread.
class HttpServer {
 public:
  // address: "HOST:PORT", port 0 = any; HTTPS if `tls` names files. References must outlive the
  // server. Errors: INVALID_ARGUMENT (not an address), UNAVAILABLE (in use).
  static absl::StatusOr<std::unique_ptr<HttpServer>> Start(const std::string& address,
                                                           const TlsFiles& tls,
                                                           CoordinatorHost& host,
                                                           PictureService& pictures,
                                                           const Access& access);
  ~HttpServer();  // Stop

  int port() const;
  void Stop();  // idempotent

 private:
  class Impl;
  explicit HttpServer(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace tessera
