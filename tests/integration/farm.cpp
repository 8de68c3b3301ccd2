#include "tests/integration/farm.h"

#include <grpcpp/create_channel.h>

#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <utility>

#include "core/base/sha256.h"

namespace tessera {
namespace {

constexpr size_t kChunkBytes = 1 << 20;

[[noreturn]] void Die(const std::string& line) {
  std::fprintf(stderr, "%s\n", line.c_str());
  std::abort();
}

bool IsTerminal(const v1::Job& job) {
  return job.state() == v1::JOB_STATE_DONE || job.state() == v1::JOB_STATE_CANCELLED ||
         job.state() == v1::JOB_STATE_FAILED;
}

std::string NextRequestId() {
  static std::atomic<int> counter = 0;
  return "test-" + std::to_string(++counter);
}

}  // namespace

std::string ScenePath(const std::string& name) {
  return std::string(TESSERA_SCENES_DIR) + "/" + name + ".glb";
}

std::string ReadFile(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) Die("cannot read " + path);
  return {std::istreambuf_iterator<char>(file), {}};
}

v1::JobSettings SmallJob(const v1::AssetRef& scene, int64_t spp, int tile_size) {
  v1::JobSettings settings;
  settings.set_scene_name(scene.name());
  *settings.add_assets() = scene;
  settings.set_width(96);
  settings.set_height(64);
  settings.set_spp(spp);
  settings.set_max_depth(4);
  settings.set_feature_spp(8);  // so that jobs have samples with and without features
  settings.set_seed(11);
  settings.set_tile_size(tile_size);
  settings.set_denoiser("none");
  return settings;
}

bool Eventually(const std::function<bool()>& condition) {
  const auto give_up = std::chrono::steady_clock::now() + kLongest;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > give_up) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  return true;
}

RpcClient::RpcClient(std::shared_ptr<grpc::Channel> channel)
    : assets_(v1::AssetService::NewStub(channel)),
      jobs_(v1::JobService::NewStub(channel)),
      workers_(v1::WorkerService::NewStub(channel)) {}

v1::AssetRef RpcClient::Upload(const std::string& name, const std::string& bytes) {
  v1::AssetRef ref;
  ref.set_name(name);
  ref.set_sha256(ToBytes(Sha256Of(bytes)));
  ref.set_size_bytes(static_cast<int64_t>(bytes.size()));
  v1::FindMissingAssetsRequest find;
  find.add_assets()->set_sha256(ref.sha256());
  find.mutable_assets(0)->set_size_bytes(ref.size_bytes());
  v1::FindMissingAssetsResponse missing;
  grpc::ClientContext find_context;
  grpc::Status status = assets_->FindMissingAssets(&find_context, find, &missing);
  if (!status.ok()) Die("FindMissingAssets: " + status.error_message());
  if (missing.missing_size() == 0) return ref;

  grpc::ClientContext context;
  v1::WriteAssetResponse response;
  const auto writer = assets_->WriteAsset(&context, &response);
  v1::WriteAssetRequest request;
  *request.mutable_asset() = find.assets(0);
  for (size_t offset = 0; offset < bytes.size(); offset += kChunkBytes) {
    request.set_offset_bytes(static_cast<int64_t>(offset));
    request.set_chunk(bytes.substr(offset, kChunkBytes));
    if (!writer->Write(request)) break;
    request.clear_asset();
  }
  writer->WritesDone();
  status = writer->Finish();
  if (!status.ok()) Die("WriteAsset: " + status.error_message());
  return ref;
}

v1::AssetRef RpcClient::UploadScene(const std::string& name) {
  return Upload(name + ".glb", ReadFile(ScenePath(name)));
}

grpc::Status RpcClient::Create(const v1::JobSettings& settings, v1::Job* job) {
  v1::CreateJobRequest request;
  *request.mutable_settings() = settings;
  request.set_request_id(NextRequestId());
  grpc::ClientContext context;
  return jobs_->CreateJob(&context, request, job);
}

v1::Job RpcClient::MustCreate(const v1::JobSettings& settings) {
  v1::Job job;
  const grpc::Status status = Create(settings, &job);
  if (!status.ok()) Die("CreateJob: " + status.error_message());
  return job;
}

v1::Job RpcClient::Get(const std::string& name) {
  v1::GetJobRequest request;
  request.set_name(name);
  grpc::ClientContext context;
  v1::Job job;
  jobs_->GetJob(&context, request, &job);
  return job;
}

v1::Job RpcClient::Watch(const std::string& name) { return WatchUntil(name, IsTerminal); }

v1::Job RpcClient::WatchUntil(const std::string& name,
                              const std::function<bool(const v1::Job&)>& condition) {
  v1::WatchJobRequest request;
  request.set_name(name);
  request.mutable_min_interval()->set_nanos(1'000'000);
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() + kLongest);
  const auto reader = jobs_->WatchJob(&context, request);
  v1::Job job;
  while (reader->Read(&job)) {
    if (condition(job) || IsTerminal(job)) {
      context.TryCancel();
      return job;
    }
  }
  return {};
}

void RpcClient::Cancel(const std::string& name) {
  v1::CancelJobRequest request;
  request.set_name(name);
  request.set_request_id(NextRequestId());
  grpc::ClientContext context;
  v1::Job job;
  jobs_->CancelJob(&context, request, &job);
}

std::vector<v1::Worker> RpcClient::Workers() {
  grpc::ClientContext context;
  v1::ListWorkersResponse response;
  workers_->ListWorkers(&context, {}, &response);
  return {response.workers().begin(), response.workers().end()};
}

ThreadWorker::ThreadWorker(std::shared_ptr<grpc::Channel> channel, int threads, bool same_process)
    : session_(std::move(channel),
               [&] {
                 WorkerOptions options;
                 options.threads = threads;
                 options.same_process = same_process;
                 return options;
               }()),
      thread_([this] { (void)session_.Run(); }) {}

ThreadWorker::~ThreadWorker() {
  session_.Stop();
  thread_.join();
}

ServerProcess::ServerProcess(const std::string& data_dir, int port,
                             const std::vector<std::string>& flags) {
  const std::string port_file = data_dir + "/ports";
  std::filesystem::remove(port_file);
  std::vector<std::string> command{TESSERA_SERVER, "--listen", "127.0.0.1:" + std::to_string(port),
                                   "--http", "127.0.0.1:0", "--data-dir", data_dir + "/data",
                                   "--port-file", port_file};
  command.insert(command.end(), flags.begin(), flags.end());
  process_ = std::make_unique<ChildProcess>(command, data_dir + "/server.log");
  const bool started = Eventually([&] {
    std::ifstream file(port_file);  // first line: the gRPC port, "grpc PORT"
    std::string line;
    if (std::getline(file, line) && !file.eof()) {
      const size_t digits = line.find_first_of("0123456789");
      if (digits != std::string::npos) port_ = std::stoi(line.substr(digits));
    }
    return process_->Ended() || port_ > 0;
  });
  if (!started || process_->Ended()) Die("tessera-server did not start:\n" + process_->Log());
}

std::shared_ptr<grpc::Channel> ServerProcess::Channel() const {
  grpc::ChannelArguments arguments;
  arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
  arguments.SetInt(GRPC_ARG_INITIAL_RECONNECT_BACKOFF_MS, 100);
  arguments.SetInt(GRPC_ARG_MAX_RECONNECT_BACKOFF_MS, 500);
  return grpc::CreateCustomChannel(address(), grpc::InsecureChannelCredentials(), arguments);
}

std::unique_ptr<ChildProcess> StartWorkerProcess(const std::string& address,
                                                 const std::string& log_path, int threads) {
  return std::make_unique<ChildProcess>(
      std::vector<std::string>{TESSERA_WORKER, "--server", address, "--threads",
                               std::to_string(threads), "--verbose"},
      log_path);
}

std::unique_ptr<ChildProcess> StartFaultyWorkerProcess(const std::string& address,
                                                       const std::string& log_path,
                                                       const std::string& name) {
  return std::make_unique<ChildProcess>(
      std::vector<std::string>{TESSERA_FAULTY_WORKER, "--server", address, "--threads", "2",
                               "--name", name, "--verbose"},
      log_path);
}

std::string HexDigest(const v1::Job& job) {
  std::string hex;
  for (const char byte : job.digest()) {
    constexpr char kDigits[] = "0123456789abcdef";
    hex.push_back(kDigits[static_cast<unsigned char>(byte) >> 4]);
    hex.push_back(kDigits[static_cast<unsigned char>(byte) & 15]);
  }
  return hex;
}

}  // namespace tessera
