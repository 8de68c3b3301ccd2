// A coordinator and workers as processes, and what they cost.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "tessera/v1/image.grpc.pb.h"
#include "tests/integration/farm.h"

namespace tessera {

// Ends the program with a line.
[[noreturn]] void Die(const std::string& line);

class FarmUnderTest {
 public:
  explicit FarmUnderTest(int worker_threads, int num_workers = 1);

  v1::AssetRef Upload(const std::string& path);
  std::string Create(const v1::JobSettings& settings);
  // Asks four times a second until the job has ended.
  v1::Job WaitForEnd(const std::string& job);
  // Until a client is told that samples have been merged.
  void WaitForSamples(const std::string& job);
  void Cancel(const std::string& job) { client_.Cancel(job); }
  // The served picture as it is now; its pixels are read and dropped. False: none yet.
  bool FetchPicture(const std::string& job, v1::ImageHeader* header);

  double ServerCpuSeconds() const;
  double WorkerCpuSeconds() const;  // of all workers
  int64_t ServerPeakBytes() const;
  int64_t WorkerPeakBytes() const;  // the same

 private:
  TemporaryDirectory directory_;
  ServerProcess server_;
  RpcClient client_;
  std::unique_ptr<v1::ImageService::Stub> images_;
  std::vector<std::unique_ptr<ChildProcess>> workers_;
};

}  // namespace tessera
