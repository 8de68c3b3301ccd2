#include "bench/farm_under_test.h"

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <thread>

#include "bench/process_usage.h"

namespace tessera {

void Die(const std::string& line) {
  std::fprintf(stderr, "error: %s\n", line.c_str());
  std::exit(1);
}

FarmUnderTest::FarmUnderTest(int worker_threads, int num_workers)
    : server_(directory_.path()),
      client_(server_.Channel()),
      images_(v1::ImageService::NewStub(server_.Channel())) {
  for (int i = 0; i < num_workers; ++i) {
    workers_.push_back(StartWorkerProcess(
        server_.address(), directory_.path() + "/worker" + std::to_string(i) + ".log",
        worker_threads));
  }
  if (!Eventually([&] { return client_.Workers().size() == workers_.size(); })) {
    Die("the workers did not come");
  }
}

v1::AssetRef FarmUnderTest::Upload(const std::string& path) {
  return client_.Upload(std::filesystem::path(path).filename(), ReadFile(path));
}

std::string FarmUnderTest::Create(const v1::JobSettings& settings) {
  return client_.MustCreate(settings).name();
}

v1::Job FarmUnderTest::WaitForEnd(const std::string& job) {
  while (true) {
    const v1::Job now = client_.Get(job);
    if (now.state() == v1::JOB_STATE_DONE || now.state() == v1::JOB_STATE_FAILED ||
        now.state() == v1::JOB_STATE_CANCELLED || now.name().empty()) {
      return now;
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(250));
  }
}

void FarmUnderTest::WaitForSamples(const std::string& job) {
  client_.WatchUntil(job, [](const v1::Job& now) { return now.progress().samples() > 0; });
}

bool FarmUnderTest::FetchPicture(const std::string& job, v1::ImageHeader* header) {
  v1::GetImageRequest request;
  request.set_job(job);
  grpc::ClientContext context;
  const auto reader = images_->GetImage(&context, request);
  v1::GetImageResponse response;
  while (reader->Read(&response)) {
    if (response.has_header()) *header = response.header();
  }
  return reader->Finish().ok();
}

double FarmUnderTest::ServerCpuSeconds() const { return CpuSecondsOf(server_.process().pid()); }
double FarmUnderTest::WorkerCpuSeconds() const {
  double seconds = 0;
  for (const auto& worker : workers_) seconds += CpuSecondsOf(worker->pid());
  return seconds;
}
int64_t FarmUnderTest::ServerPeakBytes() const { return PeakBytesOf(server_.process().pid()); }
int64_t FarmUnderTest::WorkerPeakBytes() const {
  int64_t bytes = 0;
  for (const auto& worker : workers_) bytes += PeakBytesOf(worker->pid());
  return bytes;
}

}  // namespace tessera
