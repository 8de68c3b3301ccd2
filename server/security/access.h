// Who may do what: bearer tokens with roles, and certificates of workers.
#pragma once

#include <map>
#include <string>
#include <string_view>

#include <grpcpp/server_context.h>

#include "absl/status/statusor.h"
#include "core/base/sha256.h"

namespace tessera {

// Each client role includes those before it; a worker's stands alone.
enum class Role {
  kView,    // sees jobs, pictures, films and workers
  kSubmit,  // uploads scenes, creates jobs, and steers those that it created
  kAdmin,   // steers every job
  kWorker,  // renders, and reads scenes
};

// Whoever made a call, after it was found to have the role that the call needs.
struct Caller {
  std::string name{};  // as the token file names it; empty where nobody is asked for a token
  Role role = Role::kAdmin;

  // Whether jobs of `owner` may be steered: its own, and any by an admin.
  bool MaySteer(const std::string& owner) const { return role == Role::kAdmin || name == owner; }
};

// Threads: all methods from any thread.
class Access {
 public:
  // Everybody may do everything.
  Access() = default;
  // token_file: a line "ROLE NAME TOKEN" for each token, # begins a comment; empty = no tokens.
  // require_certificates: a connection with a verified certificate is a worker, and if there are no
  // tokens a client with all rights; one without is nobody.
  // Errors: INVALID_ARGUMENT naming file, line and remedy (also of a file that others can read).
  static absl::StatusOr<Access> Open(const std::string& token_file, bool require_certificates);

  // The caller of a gRPC method. Errors: UNAUTHENTICATED, PERMISSION_DENIED, with the remedy.
  absl::StatusOr<Caller> Check(const grpc::ServerContextBase& context, Role needed) const;
  // By the value of an "authorization" header alone: "Bearer TOKEN", or "Basic ..." whose password
  // is the token, as browsers send it. Errors: as Check.
  absl::StatusOr<Caller> CheckHeader(std::string_view authorization, Role needed) const;

  bool has_tokens() const { return !callers_.empty(); }

 private:
  bool open() const { return callers_.empty() && !require_certificates_; }

  std::map<Sha256Digest, Caller> callers_;  // by the token's digest
  bool require_certificates_ = false;
};

}  // namespace tessera
