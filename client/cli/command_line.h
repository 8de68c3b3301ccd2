// The command line `tessera`, as a library: the composition root hands in what only it can link.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <grpcpp/channel.h>
#include <nlohmann/json.hpp>

#include "absl/status/statusor.h"

namespace tessera {

// A coordinator with a worker inside this process. Destroying it stops both.
class LocalFarm {
 public:
  virtual ~LocalFarm() = default;
  virtual std::shared_ptr<grpc::Channel> channel() = 0;
  // Why the worker ended by itself; OK while it works.
  virtual absl::Status worker_status() const = 0;
};

struct LocalFarmOptions {
  int threads = 0;  // 0 = all
  // Called once, from another thread, if the worker ends by itself.
  std::function<void()> on_worker_end;
};

struct SceneDescription {
  nlohmann::ordered_json members;  // an object, shown in its order
  absl::Status renderable;         // why the scene cannot be rendered
};

struct CommandLineParts {
  std::function<absl::StatusOr<std::unique_ptr<LocalFarm>>(const LocalFarmOptions&)>
      start_local_farm;
  // What a scene file needs, for `tessera info`. Errors: the file is no glTF at all.
  std::function<absl::StatusOr<SceneDescription>(const std::string& path)> describe_scene;
  std::vector<std::string> isa_classes;  // that this machine runs
  // The fingerprint of this machine's arithmetic in one of them (Hello.arithmetic).
  std::function<std::string(const std::string& isa_class)> arithmetic_of;
};

// Runs one command and returns its exit code (exit_code.h). Errors go to stderr as one line.
int RunCommandLine(int argc, const char* const* argv, const CommandLineParts& parts);

}  // namespace tessera
