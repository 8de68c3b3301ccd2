// What one client may have of a server at once. A client is the token that it shows, or else the
// address that it calls from.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>

#include <grpcpp/server_context.h>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/coordinator/event.h"
#include "server/security/access.h"

namespace tessera {

// Of one client; 0 = unlimited. The first four: of its jobs that have not ended, together.
struct ClientLimitOptions {
  int64_t jobs = 1000;
  int64_t pixels = int64_t{1} << 30;
  int64_t samples = int64_t{10'000'000'000'000};  // of all pixels
  int64_t asset_bytes = 0;  // of their scenes; of any file that is uploaded as well
  int64_t streams = 256;    // watches, pictures, films and uploads that are open
};

// "token NAME", or "address A" without the port.
std::string ClientOf(const Caller& caller, const std::string& peer);

// Threads: all methods from any thread.
class ClientLimits {
 public:
  // is_open: whether a job exists and has not ended. Called without a lock of this.
  ClientLimits(const ClientLimitOptions& options, std::function<bool(JobId)> is_open)
      : options_(options), is_open_(std::move(is_open)) {}

  // What is taken of a limit until it is destroyed.
  using Hold = std::shared_ptr<void>;

  // Makes room for a job, which counts from now on, as a job of its own once Created was called.
  // Errors: RESOURCE_EXHAUSTED naming the limit, its flag and the remedy.
  absl::StatusOr<Hold> Admit(const std::string& client, const v1::JobSettings& settings);
  // The job that was admitted exists; or one of an earlier run of the server.
  void Created(const std::string& client, JobId job, const v1::JobSettings& settings);
  // Errors: as Admit.
  absl::StatusOr<Hold> OpenStream(const std::string& client);
  // Whether a file of that size may be uploaded. Errors: as Admit.
  absl::Status CheckUpload(const std::string& client, int64_t size_bytes) const;

 private:
  struct Use {
    double jobs = 0;
    double pixels = 0;
    double samples = 0;
    double asset_bytes = 0;
  };
  static Use UseOf(const v1::JobSettings& settings);
  void Forget(const std::string& client);  // what its jobs used that have ended
  absl::Status CheckRoom(const std::string& client, const Use& used, const Use& more) const;

  const ClientLimitOptions options_;
  const std::function<bool(JobId)> is_open_;
  std::mutex mu_;  // guards all below
  std::map<std::string, std::map<JobId, Use>> jobs_;
  std::map<std::string, std::map<int64_t, Use>> admitted_;  // that are being created
  std::map<std::string, int64_t> streams_;
  int64_t next_admission_ = 1;
};

}  // namespace tessera
