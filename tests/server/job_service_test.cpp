#include "server/rpc/job_service.h"

#include <atomic>

#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include "tests/server/simulated_farm.h"

namespace tessera {
namespace {

class NoEffects : public EffectSink {
 public:
  void Apply(const Effect&) override {}
};

// The service alone, reached without a socket; saving fails when the test says so.
class JobServiceTest : public testing::Test {
 protected:
  void SetUp() override {
    grpc::ServerBuilder builder;
    builder.RegisterService(&service_);
    server_ = builder.BuildAndStart();
    stub_ = v1::JobService::NewStub(server_->InProcessChannel({}));
    settings_.mutable_assets(0)->set_sha256(ToBytes(Sha256Of("a scene")));
    settings_.mutable_assets(0)->set_size_bytes(7);
    ASSERT_TRUE(assets_->Append(Sha256Of("a scene"), 7, 0, "a scene").ok());
  }
  grpc::Status Create(const std::string& request_id, v1::Job* job) {
    grpc::ClientContext context;
    v1::CreateJobRequest request;
    *request.mutable_settings() = settings_;
    request.set_request_id(request_id);
    return stub_->CreateJob(&context, request, job);
  }
  size_t NumJobs() {
    return host_.Read([](const Coordinator& c) { return c.ListJobs(0, 100).size(); });
  }

  NoEffects effects_;
  CoordinatorHost host_{SmallConfig(), effects_};
  std::unique_ptr<AssetStore> assets_ = *AssetStore::Open("", 1000);
  WatchHub watchers_{{.get_job = [](JobId, v1::Job*) { return false; },
                      .added = [](JobId, const auto&) {},
                      .removed = [](JobId, const auto&) {}}};
  std::atomic<bool> disk_is_full_ = false;
  absl::Status Keep() const {
    return disk_is_full_ ? absl::InternalError("the disk is full") : absl::OkStatus();
  }
  const Access access_;
  ClientLimits limits_{{}, [](JobId) { return true; }};
  WriteDeadlines deadlines_{60000};
  JobService service_{
      host_, *assets_, watchers_, SmallConfig().defaults,
      {.save = [this](JobId) { return Keep(); }, .remove = [this](JobId) { return Keep(); }},
      access_,
      limits_,
      deadlines_};
  v1::JobSettings settings_ = SmallSettings();
  std::unique_ptr<grpc::Server> server_;
  std::unique_ptr<v1::JobService::Stub> stub_;
};

// Packed zeros would become a hundred gigabytes. This asset is no film: who reads it says that.
TEST_F(JobServiceTest, AFilmThatMemoryHasNoRoomForIsNotRead) {
  grpc::ClientContext context;
  v1::CreateJobRequest request;
  *request.mutable_settings() = settings_;
  request.mutable_settings()->set_tile_size(32);
  request.mutable_settings()->set_width(65536);
  request.mutable_settings()->set_height(4096);
  request.set_continue_film_sha256(ToBytes(Sha256Of("a scene")));
  v1::Job job;
  const grpc::Status status = stub_->CreateJob(&context, request, &job);
  EXPECT_EQ(status.error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED) << status.error_message();
  EXPECT_NE(status.error_message().find("MiB for films"), std::string::npos);
}

TEST_F(JobServiceTest, ARepeatedCreationThatCannotBeSavedLeavesTheJobAlone) {
  v1::Job job, repeated;
  ASSERT_TRUE(Create("r1", &job).ok());
  disk_is_full_ = true;
  EXPECT_FALSE(Create("r1", &repeated).ok());
  EXPECT_EQ(NumJobs(), 1u);
  disk_is_full_ = false;
  ASSERT_TRUE(Create("r1", &repeated).ok());
  EXPECT_EQ(repeated.name(), job.name());
}

TEST_F(JobServiceTest, ACreationThatCannotBeSavedCanBeRepeated) {
  v1::Job job;
  disk_is_full_ = true;
  EXPECT_FALSE(Create("r1", &job).ok());
  EXPECT_EQ(NumJobs(), 0u);
  disk_is_full_ = false;
  ASSERT_TRUE(Create("r1", &job).ok()) << "it is new, not the one that was taken back";
  EXPECT_EQ(NumJobs(), 1u);
}

TEST_F(JobServiceTest, ACommandThatCannotBeSavedIsNotAcknowledged) {
  v1::Job job;
  ASSERT_TRUE(Create("r1", &job).ok());
  const auto pause = [&] {
    grpc::ClientContext context;
    v1::PauseJobRequest request;
    request.set_name(job.name());
    request.set_request_id("r2");
    return stub_->PauseJob(&context, request, &job);
  };
  disk_is_full_ = true;
  const grpc::Status refused = pause();
  EXPECT_EQ(refused.error_code(), grpc::StatusCode::UNAVAILABLE) << "repeat it, with the same id";
  EXPECT_NE(refused.error_message().find("the disk is full"), std::string::npos);
  disk_is_full_ = false;
  EXPECT_TRUE(pause().ok());
  EXPECT_EQ(job.state(), v1::JOB_STATE_PAUSED);
}

TEST_F(JobServiceTest, PagesAreBoundedInBytes) {
  for (int i = 0; i < 200; ++i) {
    v1::AssetRef asset = settings_.assets(0);
    asset.set_name(std::to_string(i) + std::string(3000, 'x'));
    *settings_.add_assets() = asset;
  }
  v1::Job job;
  for (int i = 0; i < 4; ++i) ASSERT_TRUE(Create("", &job).ok());
  v1::ListJobsRequest request;
  std::vector<std::string> names;
  int pages = 0;
  do {
    grpc::ClientContext context;
    v1::ListJobsResponse page;
    ASSERT_TRUE(stub_->ListJobs(&context, request, &page).ok());
    EXPECT_LE(page.ByteSizeLong(), size_t{2} << 20);
    for (const v1::Job& listed : page.jobs()) names.push_back(listed.name());
    request.set_page_token(page.next_page_token());
    ++pages;
  } while (!request.page_token().empty());
  EXPECT_EQ(names, (std::vector<std::string>{"jobs/1", "jobs/2", "jobs/3", "jobs/4"}));
  EXPECT_EQ(pages, 4) << "each has 600 kB";
}

// By then the quota may be full, or assets gone.
TEST_F(JobServiceTest, ARepeatedCreationNeedsNothingOfANewOne) {
  v1::Job job, repeated;
  ASSERT_TRUE(Create("r1", &job).ok());
  settings_.mutable_assets(0)->set_sha256(std::string(32, 'z'));
  ASSERT_TRUE(Create("r1", &repeated).ok());
  EXPECT_EQ(repeated.name(), job.name());
}

}  // namespace
}  // namespace tessera
