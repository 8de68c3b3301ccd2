// Pictures that workers help to filter, on real processes: the same bits as the server's own.
#include <gtest/gtest.h>
#include <signal.h>

#include <memory>
#include <string>
#include <vector>

#include "tessera/v1/image.grpc.pb.h"
#include "tests/integration/farm.h"

namespace tessera {
namespace {

// All that filters make, as it travels to a client.
std::string PictureOf(const std::shared_ptr<grpc::Channel>& channel, const std::string& job) {
  const auto stub = v1::ImageService::NewStub(channel);
  v1::GetImageRequest request;
  request.set_job(job);
  for (const char* const layer : {"final", "raw", "variance", "error"}) request.add_layers(layer);
  request.set_wait_for_filter(true);
  grpc::ClientContext context;
  const auto reader = stub->GetImage(&context, request);
  std::string picture;
  v1::GetImageResponse response;
  while (reader->Read(&response)) picture += response.chunk();
  EXPECT_TRUE(reader->Finish().ok());
  return picture;
}

v1::JobSettings FilteredJob(RpcClient& client, uint64_t seed) {
  v1::JobSettings settings = SmallJob(client.UploadScene("cornell"), 4, 16);
  settings.set_denoiser("regression");
  settings.set_seed(seed);
  return settings;
}

// The picture of the job from a coordinator with workers of its own process.
std::string OwnPicture(uint64_t seed) {
  auto service = Service::Start({});
  EXPECT_TRUE(service.ok()) << service.status();
  const auto channel = (*service)->InProcessChannel();
  ThreadWorker worker(channel, 1, /*same_process=*/true);
  RpcClient client(channel);
  const v1::Job job = client.Watch(client.MustCreate(FilteredJob(client, seed)).name());
  EXPECT_EQ(job.state(), v1::JOB_STATE_DONE) << job.error();
  EXPECT_EQ(client.Workers().at(0).filtered_windows(), 0) << "the cores are the same";
  return PictureOf(channel, job.name());
}

class FilterWorkers : public ::testing::Test {
 protected:
  void StartFarm(const std::vector<std::string>& flags, int workers) {
    server_ = std::make_unique<ServerProcess>(directory_.path(), 0, flags);
    client_ = std::make_unique<RpcClient>(server_->Channel());
    for (int i = 0; i < workers; ++i) {
      workers_.push_back(StartWorkerProcess(
          server_->address(), directory_.path() + "/worker" + std::to_string(i)));
    }
    ASSERT_TRUE(Eventually(
        [&] { return client_->Workers().size() == static_cast<size_t>(workers); }));
  }
  std::string RenderedPicture(uint64_t seed) {
    const v1::Job job = client_->Watch(client_->MustCreate(FilteredJob(*client_, seed)).name());
    EXPECT_EQ(job.state(), v1::JOB_STATE_DONE) << job.error() << server_->process().Log();
    return PictureOf(server_->Channel(), job.name());
  }
  int64_t WindowsFiltered() {
    int64_t windows = 0;
    for (const v1::Worker& worker : client_->Workers()) windows += worker.filtered_windows();
    return windows;
  }

  TemporaryDirectory directory_;
  std::unique_ptr<ServerProcess> server_;
  std::unique_ptr<RpcClient> client_;
  std::vector<std::unique_ptr<ChildProcess>> workers_;
};

TEST_F(FilterWorkers, TheSameBitsAsTheServersOwn) {
  StartFarm({"--filter-on", "workers", "--lease-ttl", "60"}, 2);
  EXPECT_EQ(RenderedPicture(1), OwnPicture(1));
  EXPECT_GT(WindowsFiltered(), 0) << server_->process().Log() << workers_[0]->Log();
}

TEST_F(FilterWorkers, AuditedAll) {
  // Long leases: a machine that stands still for seconds loses no window.
  StartFarm({"--filter-on", "workers", "--audit-rate", "1", "--lease-ttl", "60"}, 0);
  for (const char* const name : {"one", "two"}) {
    workers_.push_back(std::make_unique<ChildProcess>(
        std::vector<std::string>{TESSERA_WORKER, "--server", server_->address(), "--threads", "1",
                                 "--name", name},
        directory_.path() + "/" + name));
  }
  EXPECT_EQ(RenderedPicture(2), OwnPicture(2));
  EXPECT_GT(WindowsFiltered(), 0) << server_->process().Log() << workers_[0]->Log();
  EXPECT_EQ(client_->Workers().size(), 2u) << "nobody was banned";
}

TEST_F(FilterWorkers, TheServerAloneIfAskedTo) {
  StartFarm({"--filter-on", "server"}, 1);
  EXPECT_EQ(RenderedPicture(1), OwnPicture(1));
  EXPECT_EQ(WindowsFiltered(), 0);
}

// Whenever that happens: its windows are the server's again.
TEST_F(FilterWorkers, AWorkerKilledAtTheEnd) {
  StartFarm({"--filter-on", "workers"}, 2);
  const std::string name = client_->MustCreate(FilteredJob(*client_, 3)).name();
  client_->WatchUntil(name, [](const v1::Job& job) {
    return job.state() == v1::JOB_STATE_FINISHING;
  });
  workers_[0]->Signal(SIGKILL);
  workers_[0]->Wait();
  const v1::Job job = client_->Watch(name);
  EXPECT_EQ(job.state(), v1::JOB_STATE_DONE) << job.error() << server_->process().Log();
  EXPECT_EQ(PictureOf(server_->Channel(), name), OwnPicture(3));
}

}  // namespace
}  // namespace tessera
