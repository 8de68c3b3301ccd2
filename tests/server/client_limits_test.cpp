// What one client may have of a server at once, and clients that do not read.
#include "server/rpc/client_limits.h"

#include <set>

#include <gmock/gmock.h>

#include "tests/server/service_fixture.h"

namespace tessera {
namespace {

using ::testing::HasSubstr;

TEST(ClientOf, IsTheTokenOrElseTheAddress) {
  EXPECT_EQ(ClientOf(Caller{.name = "ann"}, "ipv4:10.0.0.1:99"), "token ann");
  EXPECT_EQ(ClientOf(Caller{}, "ipv4:10.0.0.1:99"), "address ipv4:10.0.0.1");
  EXPECT_EQ(ClientOf(Caller{}, "ipv6:[::1]:99"), "address ipv6:[::1]");
  EXPECT_EQ(ClientOf(Caller{}, "unix:"), "address unix:");
}

class ClientLimitsTest : public testing::Test {
 protected:
  // Admits and creates a job of 100 x 10 pixels, 4 samples each, with files of 50 bytes.
  absl::Status Create(ClientLimits& limits, const std::string& client, JobId job) {
    v1::JobSettings settings;
    settings.set_width(100);
    settings.set_height(10);
    settings.set_spp(4);
    settings.add_assets()->set_size_bytes(50);
    const absl::StatusOr<ClientLimits::Hold> hold = limits.Admit(client, settings);
    if (!hold.ok()) return hold.status();
    open_.insert(job);
    limits.Created(client, job, settings);
    return absl::OkStatus();
  }
  // Two jobs fit, a third one does when one of them has ended, and other clients do not matter.
  void ExpectRoomForTwo(const ClientLimitOptions& options, const std::string& flag) {
    ClientLimits limits(options, [this](JobId job) { return open_.contains(job); });
    EXPECT_TRUE(Create(limits, "a", 1).ok());
    EXPECT_TRUE(Create(limits, "a", 2).ok());
    const absl::Status refused = Create(limits, "a", 3);
    EXPECT_TRUE(absl::IsResourceExhausted(refused)) << refused;
    EXPECT_THAT(std::string(refused.message()), HasSubstr(flag));
    EXPECT_TRUE(Create(limits, "b", 4).ok());
    open_.erase(1);
    EXPECT_TRUE(Create(limits, "a", 5).ok());
    EXPECT_FALSE(Create(limits, "a", 6).ok());
  }
  static constexpr ClientLimitOptions kNone{0, 0, 0, 0, 0};
  std::set<JobId> open_;
};

TEST_F(ClientLimitsTest, BoundJobsPixelsSamplesAndFiles) {
  ClientLimitOptions options = kNone;
  options.jobs = 2;
  ExpectRoomForTwo(options, "--client-jobs");
  options = kNone;
  options.pixels = 2999;
  ExpectRoomForTwo(options, "--client-pixels");
  options = kNone;
  options.samples = 8000;
  ExpectRoomForTwo(options, "--client-samples");
  options = kNone;
  options.asset_bytes = 120;
  ExpectRoomForTwo(options, "--client-asset-bytes");
}

TEST_F(ClientLimitsTest, AJobThatIsBeingCreatedCounts) {
  ClientLimitOptions options = kNone;
  options.jobs = 1;
  ClientLimits limits(options, [](JobId) { return true; });
  {
    const auto first = limits.Admit("a", {});
    EXPECT_TRUE(first.ok());
    EXPECT_FALSE(limits.Admit("a", {}).ok());
  }
  EXPECT_TRUE(limits.Admit("a", {}).ok()) << "it was not created after all";
}

TEST_F(ClientLimitsTest, BoundStreamsAndUploads) {
  ClientLimitOptions options = kNone;
  options.streams = 1;
  options.asset_bytes = 10;
  ClientLimits limits(options, [](JobId) { return true; });
  {
    const auto stream = limits.OpenStream("a");
    EXPECT_TRUE(stream.ok());
    EXPECT_THAT(std::string(limits.OpenStream("a").status().message()),
                HasSubstr("--client-streams"));
    EXPECT_TRUE(limits.OpenStream("b").ok());
  }
  EXPECT_TRUE(limits.OpenStream("a").ok());
  EXPECT_TRUE(limits.CheckUpload("a", 10).ok());
  EXPECT_THAT(std::string(limits.CheckUpload("a", 11).message()),
              HasSubstr("--client-asset-bytes"));
}

TEST_F(ClientLimitsTest, NothingIsBoundedByZero) {
  ClientLimits limits(kNone, [](JobId) { return true; });
  for (JobId job = 1; job < 100; ++job) EXPECT_TRUE(Create(limits, "a", job).ok());
}

class LimitedService : public ServiceFixture {};

TEST_F(LimitedService, RefusesAClientsSecondJobAndSecondWatch) {
  ServiceOptions options;
  options.client_limits.jobs = 1;
  options.client_limits.streams = 1;
  StartService(options);
  v1::Job job, refused;
  const v1::JobSettings settings = UploadedSettings(4);
  ASSERT_TRUE(Create(settings, &job).ok());
  const grpc::Status status = Create(settings, &refused);
  EXPECT_EQ(status.error_code(), grpc::RESOURCE_EXHAUSTED);
  EXPECT_THAT(status.error_message(), HasSubstr("--client-jobs"));

  v1::WatchJobRequest request;
  request.set_name(job.name());
  grpc::ClientContext first_context, second_context;
  const auto first = jobs->WatchJob(&first_context, request);
  v1::Job seen;
  ASSERT_TRUE(first->Read(&seen));
  const auto second = jobs->WatchJob(&second_context, request);
  EXPECT_FALSE(second->Read(&seen));
  EXPECT_THAT(second->Finish().error_message(), HasSubstr("--client-streams"));
  first_context.TryCancel();
  first->Finish();
}

TEST_F(LimitedService, AClientThatNeverReadsLosesItsStream) {
  ServiceOptions options;
  options.client_limits.streams = 1;
  options.write_deadline = std::chrono::milliseconds(100);
  StartService(options);
  v1::JobSettings settings = UploadedSettings(1);
  settings.set_width(2048);
  settings.set_height(2048);
  settings.set_tile_size(64);
  settings.clear_region();
  v1::Job job;
  ASSERT_TRUE(Create(settings, &job).ok());
  v1::GetImageRequest request;  // 50 MB: more than the link takes unread
  request.set_job(job.name());
  request.add_layers("raw");
  grpc::ClientContext deaf_context;
  const auto deaf = images->GetImage(&deaf_context, request);
  deaf->WaitForInitialMetadata();
  // Its place is free again, though it never reads.
  v1::WatchJobRequest watch;
  watch.set_name(job.name());
  for (bool is_watching = false; !is_watching;) {
    grpc::ClientContext context;
    const auto reader = jobs->WatchJob(&context, watch);
    v1::Job seen;
    is_watching = reader->Read(&seen);
    context.TryCancel();
    reader->Finish();
  }
  v1::GetImageResponse response;
  while (deaf->Read(&response)) {
  }
  EXPECT_FALSE(deaf->Finish().ok());
}

TEST_F(LimitedService, AnUploadThatStandsStillEndsAndMayBeResumed) {
  ServiceOptions options;
  options.client_limits.streams = 1;
  options.write_deadline = std::chrono::milliseconds(100);
  StartService(options);
  const std::string content(1000, 'x');
  const auto message = [&](size_t offset, size_t size) {
    v1::WriteAssetRequest request;
    request.mutable_asset()->set_sha256(ToBytes(Sha256Of(content)));
    request.mutable_asset()->set_size_bytes(static_cast<int64_t>(content.size()));
    request.set_offset_bytes(static_cast<int64_t>(offset));
    request.set_chunk(content.substr(offset, size));
    return request;
  };
  grpc::ClientContext still_context;
  v1::WriteAssetResponse response;
  const auto still = assets->WriteAsset(&still_context, &response);
  still->Write(message(0, 400));
  const grpc::Status status = still->Finish();  // it never says that this was all
  // Its place is free again. On a busy machine this one may be too slow as well.
  for (bool is_sent = false; !is_sent;) {
    grpc::ClientContext context;
    const auto resumed = assets->WriteAsset(&context, &response);
    resumed->Write(message(0, 1000));
    resumed->WritesDone();
    is_sent = resumed->Finish().ok();
  }
  EXPECT_EQ(response.received_bytes(), 1000);
  EXPECT_EQ(status.error_code(), grpc::StatusCode::UNAVAILABLE);
  EXPECT_THAT(status.error_message(), HasSubstr("--write-deadline"));
}

TEST_F(LimitedService, AWatchOfChangesLeavesOutWhatHasNotChanged) {
  StartService();
  v1::Job job;
  ASSERT_TRUE(Create(UploadedSettings(16), &job).ok());
  v1::WatchJobRequest request;
  request.set_name(job.name());
  request.set_only_changes(true);
  request.mutable_min_interval()->set_nanos(1);
  grpc::ClientContext context;
  const auto reader = jobs->WatchJob(&context, request);
  v1::Job first, next;
  ASSERT_TRUE(reader->Read(&first));
  EXPECT_EQ(first.settings().width(), job.settings().width());
  SyntheticWorker worker(channel);
  int others = 0;
  while (reader->Read(&next)) {
    EXPECT_FALSE(next.has_settings());
    EXPECT_EQ(next.name(), job.name());
    ++others;
  }
  EXPECT_TRUE(reader->Finish().ok());
  EXPECT_GT(others, 0);
  EXPECT_EQ(next.state(), v1::JOB_STATE_DONE);
}

TEST_F(LimitedService, WhereOneLooksIsKeptAndChecked) {
  StartService();
  v1::Job job, looked;
  ASSERT_TRUE(Create(UploadedSettings(16), &job).ok());
  const auto look = [&](const std::string& name, int x, int width) {
    v1::LookJobRequest request;
    request.set_name(name);
    if (width > 0) {
      request.mutable_region()->set_x(x);
      request.mutable_region()->set_width(width);
      request.mutable_region()->set_height(1);
    }
    grpc::ClientContext context;
    return jobs->LookJob(&context, request, &looked);
  };
  ASSERT_TRUE(look(job.name(), 1, 3).ok());
  EXPECT_EQ(looked.settings().look().x(), 1);
  EXPECT_EQ(looked.settings().look().width(), 3);
  EXPECT_GT(looked.revision().counter(), job.revision().counter());
  EXPECT_EQ(look(job.name(), 1, 1000).error_code(), grpc::INVALID_ARGUMENT);
  EXPECT_EQ(look("jobs/99", 1, 3).error_code(), grpc::NOT_FOUND);
  EXPECT_EQ(look("job", 1, 3).error_code(), grpc::INVALID_ARGUMENT);
  ASSERT_TRUE(look(job.name(), 0, 0).ok());
  EXPECT_FALSE(looked.settings().has_look());
}

}  // namespace
}  // namespace tessera
