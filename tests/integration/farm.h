// A farm for a test: a coordinator and workers, inside the test's process or as real processes, and
// a plain client of the RPCs.
#pragma once

#include <grpcpp/channel.h>

#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "server/service.h"
#include "tessera/v1/asset.grpc.pb.h"
#include "tessera/v1/job.grpc.pb.h"
#include "tessera/v1/worker.grpc.pb.h"
#include "tests/integration/child_process.h"
#include "worker/session/worker_session.h"

namespace tessera {

// Nothing takes this long; a test that reaches it fails.
inline constexpr std::chrono::seconds kLongest{60};

std::string ScenePath(const std::string& name);  // of the project's own scenes, without ".glb"
std::string ReadFile(const std::string& path);

// A small crop-sized job of a scene whose asset is `scene`.
v1::JobSettings SmallJob(const v1::AssetRef& scene, int64_t spp, int tile_size);

// Looks again until `condition` or kLongest has passed; the last look's result.
bool Eventually(const std::function<bool()>& condition);

// Threads: any.
class RpcClient {
 public:
  explicit RpcClient(std::shared_ptr<grpc::Channel> channel);

  // Uploads a file; aborts the test program when the server refuses it.
  v1::AssetRef Upload(const std::string& name, const std::string& bytes);
  v1::AssetRef UploadScene(const std::string& name);
  grpc::Status Create(const v1::JobSettings& settings, v1::Job* job);
  v1::Job MustCreate(const v1::JobSettings& settings);
  v1::Job Get(const std::string& job);
  // Watches until a terminal state; an empty Job when the server went away.
  v1::Job Watch(const std::string& job);
  // Watches until the condition holds or the job ends.
  v1::Job WatchUntil(const std::string& job, const std::function<bool(const v1::Job&)>& condition);
  void Cancel(const std::string& job);
  std::vector<v1::Worker> Workers();

  v1::AssetService::Stub& assets() { return *assets_; }
  v1::JobService::Stub& jobs() { return *jobs_; }
  v1::WorkerService::Stub& workers() { return *workers_; }

 private:
  std::unique_ptr<v1::AssetService::Stub> assets_;
  std::unique_ptr<v1::JobService::Stub> jobs_;
  std::unique_ptr<v1::WorkerService::Stub> workers_;
};

// A WorkerSession on a thread of this process; stops with the object.
class ThreadWorker {
 public:
  ThreadWorker(std::shared_ptr<grpc::Channel> channel, int threads, bool same_process);
  ~ThreadWorker();

 private:
  WorkerSession session_;
  std::thread thread_;
};

// A tessera-server with its data in a directory of its own.
class ServerProcess {
 public:
  // data_dir must outlive it. port 0: the system chooses. flags: further ones.
  explicit ServerProcess(const std::string& data_dir, int port = 0,
                         const std::vector<std::string>& flags = {});

  int port() const { return port_; }
  std::string address() const { return "127.0.0.1:" + std::to_string(port_); }
  std::shared_ptr<grpc::Channel> Channel() const;
  ChildProcess& process() const { return *process_; }

 private:
  int port_ = 0;
  std::unique_ptr<ChildProcess> process_;
};

std::unique_ptr<ChildProcess> StartWorkerProcess(const std::string& address,
                                                 const std::string& log_path, int threads = 1);
// As that, with a renderer that breaks as faulty_renderer.h says.
std::unique_ptr<ChildProcess> StartFaultyWorkerProcess(const std::string& address,
                                                       const std::string& log_path,
                                                       const std::string& name);

std::string HexDigest(const v1::Job& job);

}  // namespace tessera
