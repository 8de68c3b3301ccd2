#include "client/farm_client.h"

#include <bit>
#include <cstring>
#include <set>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/film/delta_codec.h"
#include "tests/client/fake_farm.h"
#include "tests/client/temporary_folder.h"

namespace tessera {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

class FarmClientTest : public ::testing::Test {
 protected:
  // A client that notes its waits instead of waiting.
  FarmClient MakeClient() {
    FarmClientOptions options;
    options.address = "farm:4242";
    options.token = "secret";
    options.retry.sleep = [this](std::chrono::milliseconds wait, std::stop_token) {
      waits_ms_.push_back(wait.count());
    };
    return FarmClient(farm_.channel(), options);
  }

  AssetFile MakeAsset(const std::string& name, const std::string& bytes) {
    return *HashFile(name, folder_.Write(name, bytes));
  }

  TemporaryFolder folder_;
  FakeFarm farm_;
  std::vector<int64_t> waits_ms_;
};

std::string Pattern(size_t bytes) {
  std::string text(bytes, '\0');
  for (size_t i = 0; i < bytes; ++i) text[i] = static_cast<char>(i * 31 >> 3);
  return text;
}

// --- uploads ---

TEST_F(FarmClientTest, UploadSendsOnlyWhatIsMissingInSmallChunks) {
  const AssetFile known = MakeAsset("known.bin", "old");
  const AssetFile large = MakeAsset("large.bin", Pattern(3 << 20));
  const AssetFile empty = MakeAsset("empty.bin", "");
  farm_.assets.received[ToBytes(known.sha256)] = "old";
  const auto report = MakeClient().Upload({known, large, empty});
  ASSERT_TRUE(report.ok()) << report.status();
  EXPECT_EQ(report->files_sent, 2);
  EXPECT_EQ(report->bytes_sent, 3 << 20);
  EXPECT_EQ(farm_.assets.received[ToBytes(large.sha256)], Pattern(3 << 20));
  EXPECT_EQ(farm_.assets.received.count(ToBytes(empty.sha256)), 1u);
  EXPECT_LE(farm_.assets.largest_chunk_bytes, size_t{1} << 20);
}

TEST_F(FarmClientTest, UploadResumesWhereTheLinkBroke) {
  const AssetFile large = MakeAsset("large.bin", Pattern(3 << 20));
  farm_.assets.break_after_bytes = 1 << 20;
  std::vector<int64_t> done;
  const auto report = MakeClient().Upload(
      {large}, [&](int64_t bytes_done, int64_t) { done.push_back(bytes_done); });
  ASSERT_TRUE(report.ok()) << report.status();
  EXPECT_EQ(farm_.assets.received[ToBytes(large.sha256)], Pattern(3 << 20));
  EXPECT_THAT(farm_.assets.stream_offsets, ElementsAre(0, 1 << 20));
  EXPECT_EQ(waits_ms_.size(), 1u);
  EXPECT_EQ(done.back(), 3 << 20);
}

TEST_F(FarmClientTest, UploadOfTwoEqualFilesSendsOne) {
  const auto report =
      MakeClient().Upload({MakeAsset("a.bin", "same"), MakeAsset("b.bin", "same")});
  ASSERT_TRUE(report.ok()) << report.status();
  EXPECT_EQ(report->bytes_sent, 4);
}

TEST_F(FarmClientTest, UploadNoticesAFileThatShrank) {
  AssetFile file = MakeAsset("a.bin", "12345678");
  folder_.Write("a.bin", "123");
  const auto report = MakeClient().Upload({file});
  EXPECT_TRUE(absl::IsDataLoss(report.status())) << report.status();
  EXPECT_THAT(std::string(report.status().message()), HasSubstr("a.bin"));
}

// --- retries ---

TEST_F(FarmClientTest, RepeatedMutationKeepsItsRequestId) {
  std::vector<std::string> ids;
  farm_.jobs.create = [&](const v1::CreateJobRequest& request, v1::Job* job) {
    ids.push_back(request.request_id());
    if (ids.size() < 3) return Unavailable();
    job->set_name("jobs/1");
    return grpc::Status::OK;
  };
  FarmClient client = MakeClient();
  const auto job = client.CreateJob(v1::JobSettings());
  ASSERT_TRUE(job.ok()) << job.status();
  EXPECT_EQ(ids.size(), 3u);
  EXPECT_EQ(std::set<std::string>(ids.begin(), ids.end()).size(), 1u);
  EXPECT_FALSE(ids.front().empty());
  EXPECT_THAT(waits_ms_, ElementsAre(100, 200));
  // Another mutation has another id.
  ASSERT_TRUE(client.CreateJob(v1::JobSettings()).ok());
  EXPECT_NE(ids.back(), ids.front());
}

TEST_F(FarmClientTest, GivesUpOnAServerThatWasNeverReached) {
  int calls = 0;
  farm_.jobs.get = [&](const v1::GetJobRequest&, v1::Job*) {
    ++calls;
    return Unavailable();
  };
  const auto job = MakeClient().GetJob("jobs/1");
  EXPECT_TRUE(absl::IsUnavailable(job.status()));
  EXPECT_EQ(calls, RetryOptions().first_contact_attempts);
  EXPECT_EQ(job.status().message(),
            "no server at farm:4242: start one with tessera-server, give --ca if it speaks TLS, or "
            "drop --server to render here");
}

TEST_F(FarmClientTest, IsMorePatientWithAServerThatHasAnswered) {
  int calls = 0;
  farm_.jobs.get = [&](const v1::GetJobRequest&, v1::Job*) {
    return ++calls == 1 ? grpc::Status::OK : Unavailable();
  };
  FarmClient client = MakeClient();
  ASSERT_TRUE(client.GetJob("jobs/1").ok());
  const auto job = client.GetJob("jobs/1");
  EXPECT_TRUE(absl::IsUnavailable(job.status()));
  EXPECT_EQ(calls, 1 + RetryOptions().attempts_max);
  EXPECT_THAT(std::string(job.status().message()), HasSubstr("lost the server at farm:4242"));
  EXPECT_EQ(waits_ms_.back(), RetryOptions().backoff_max.count());
}

TEST_F(FarmClientTest, AnswersOfTheServerAreFinalAndKeepTheirLine) {
  int calls = 0;
  farm_.jobs.get = [&](const v1::GetJobRequest&, v1::Job*) {
    ++calls;
    return grpc::Status(grpc::StatusCode::NOT_FOUND, "jobs/9 does not exist");
  };
  const auto job = MakeClient().GetJob("jobs/9");
  EXPECT_TRUE(absl::IsNotFound(job.status()));
  EXPECT_EQ(job.status().message(), "jobs/9 does not exist");
  EXPECT_EQ(calls, 1);
}

TEST_F(FarmClientTest, SendsItsToken) {
  std::string token;
  farm_.jobs.on_call = [&](const grpc::ServerContext& context) {
    const auto found = context.client_metadata().find("authorization");
    if (found != context.client_metadata().end()) {
      token.assign(found->second.data(), found->second.size());
    }
  };
  farm_.jobs.get = [](const v1::GetJobRequest&, v1::Job*) { return grpc::Status::OK; };
  ASSERT_TRUE(MakeClient().GetJob("jobs/1").ok());
  EXPECT_EQ(token, "Bearer secret");
}

TEST_F(FarmClientTest, ListsAllPages) {
  farm_.jobs.list = [](const v1::ListJobsRequest& request, v1::ListJobsResponse* response) {
    response->add_jobs()->set_name(request.page_token().empty() ? "jobs/1" : "jobs/2");
    if (request.page_token().empty()) response->set_next_page_token("more");
    return grpc::Status::OK;
  };
  const auto jobs = MakeClient().ListJobs();
  ASSERT_TRUE(jobs.ok());
  ASSERT_EQ(jobs->size(), 2u);
  EXPECT_EQ((*jobs)[1].name(), "jobs/2");
}

// --- watching ---

v1::Job JobAt(uint64_t counter, v1::JobState state) {
  v1::Job job;
  job.set_name("jobs/1");
  job.mutable_revision()->set_incarnation(7);
  job.mutable_revision()->set_counter(counter);
  job.set_state(state);
  return job;
}

TEST_F(FarmClientTest, WatchTakesUpABrokenStreamAtItsLastRevision) {
  std::vector<uint64_t> asked_from;
  farm_.jobs.watch = [&](const v1::WatchJobRequest& request, grpc::ServerWriter<v1::Job>* writer,
                         grpc::ServerContext*) {
    asked_from.push_back(request.from_revision().counter());
    EXPECT_FALSE(request.has_region());
    if (asked_from.size() == 1) {
      writer->Write(JobAt(1, v1::JOB_STATE_QUEUED));
      writer->Write(JobAt(2, v1::JOB_STATE_RUNNING));
      return Unavailable();
    }
    if (asked_from.size() == 2) return grpc::Status::OK;  // ended, although the job has not
    writer->Write(JobAt(5, v1::JOB_STATE_DONE));
    return grpc::Status::OK;
  };
  std::vector<uint64_t> seen;
  const auto job = MakeClient().Watch(
      "jobs/1", [&](const v1::Job& now) { seen.push_back(now.revision().counter()); });
  ASSERT_TRUE(job.ok()) << job.status();
  EXPECT_EQ(job->state(), v1::JOB_STATE_DONE);
  EXPECT_THAT(seen, ElementsAre(1, 2, 5));
  EXPECT_THAT(asked_from, ElementsAre(0, 2, 2));
}

TEST_F(FarmClientTest, WatchSaysWhatItLooksAt) {
  v1::Region region;
  region.set_x(3);
  region.set_width(5);
  farm_.jobs.watch = [&](const v1::WatchJobRequest& request, grpc::ServerWriter<v1::Job>* writer,
                         grpc::ServerContext*) {
    EXPECT_EQ(request.region().SerializeAsString(), region.SerializeAsString());
    writer->Write(JobAt(1, v1::JOB_STATE_DONE));
    return grpc::Status::OK;
  };
  EXPECT_TRUE(MakeClient().Watch("jobs/1", nullptr, kWatchInterval, {}, region).ok());
}

TEST_F(FarmClientTest, WatchGivesUpOnlyAfterManyAttemptsWithoutNews) {
  int streams = 0;
  farm_.jobs.watch = [&](const v1::WatchJobRequest&, grpc::ServerWriter<v1::Job>* writer,
                         grpc::ServerContext*) {
    if (++streams == 1) writer->Write(JobAt(1, v1::JOB_STATE_RUNNING));
    return Unavailable();
  };
  const auto job = MakeClient().Watch("jobs/1", nullptr);
  EXPECT_TRUE(absl::IsUnavailable(job.status()));
  EXPECT_EQ(streams, RetryOptions().attempts_max);
}

TEST_F(FarmClientTest, WatchStopsWhenAsked) {
  std::stop_source stop;
  farm_.jobs.watch = [&](const v1::WatchJobRequest&, grpc::ServerWriter<v1::Job>* writer,
                         grpc::ServerContext* context) {
    writer->Write(JobAt(1, v1::JOB_STATE_RUNNING));
    while (!context->IsCancelled()) {  // until the client goes
    }
    return grpc::Status::CANCELLED;
  };
  const auto job = MakeClient().Watch(
      "jobs/1", [&](const v1::Job&) { stop.request_stop(); }, kWatchInterval, stop.get_token());
  EXPECT_TRUE(absl::IsCancelled(job.status())) << job.status();
}

// --- pictures ---

std::string Words(const std::vector<uint32_t>& words) {
  return std::string(reinterpret_cast<const char*>(words.data()), words.size() * sizeof(uint32_t));
}

v1::GetImageResponse HeaderOf2x1() {
  v1::GetImageResponse response;
  v1::ImageHeader* header = response.mutable_header();
  header->mutable_region()->set_x(3);
  header->mutable_region()->set_y(1);
  header->mutable_region()->set_width(2);
  header->mutable_region()->set_height(1);
  header->set_frame_width(8);
  header->set_frame_height(4);
  header->set_spp(12.5);
  v1::ImageLayer* depth = header->add_layers();
  depth->set_name("Z");
  depth->add_channels("Z");
  v1::ImageLayer* id = header->add_layers();
  id->set_name("id");
  id->set_is_uint(true);
  id->add_channels("id");
  return response;
}

TEST_F(FarmClientTest, ImageArrivesInPiecesCutAnywhere) {
  const std::string bytes = Words({std::bit_cast<uint32_t>(1.5f), std::bit_cast<uint32_t>(-2.0f),
                                   7, 9});
  for (size_t piece = 1; piece <= bytes.size(); ++piece) {
    farm_.images.image = [&](const v1::GetImageRequest& request,
                             grpc::ServerWriter<v1::GetImageResponse>* writer) {
      EXPECT_THAT(request.layers(), ElementsAre("Z", "id"));
      EXPECT_EQ(request.region().x(), 3);
      writer->Write(HeaderOf2x1());
      for (size_t begin = 0; begin < bytes.size(); begin += piece) {
        v1::GetImageResponse response;
        response.set_chunk(bytes.substr(begin, piece));
        writer->Write(response);
      }
      return grpc::Status::OK;
    };
    const auto fetched =
        MakeClient().GetImage("jobs/1", {PixelRect::FromSize(3, 1, 2, 1), {"Z", "id"}, true});
    ASSERT_TRUE(fetched.ok()) << fetched.status();
    EXPECT_EQ(fetched->spp, 12.5);
    EXPECT_EQ(fetched->image.data_window, PixelRect::FromSize(3, 1, 2, 1));
    EXPECT_EQ(fetched->image.display_window, PixelRect::FromSize(0, 0, 8, 4));
    EXPECT_THAT(fetched->image.Find("Z")->floats, ElementsAre(1.5f, -2.0f));
    EXPECT_THAT(fetched->image.Find("id")->uints, ElementsAre(7u, 9u));
  }
}

TEST_F(FarmClientTest, ImageThatBreaksItsPromiseIsRefused) {
  for (const size_t words : {0u, 3u, 5u}) {
    farm_.images.image = [&](const v1::GetImageRequest&,
                             grpc::ServerWriter<v1::GetImageResponse>* writer) {
      v1::GetImageResponse response = HeaderOf2x1();
      response.set_chunk(Words(std::vector<uint32_t>(words, 1)));
      writer->Write(response);
      return grpc::Status::OK;
    };
    const auto fetched = MakeClient().GetImage("jobs/1", {});
    EXPECT_TRUE(absl::IsInternal(fetched.status())) << words;
  }
}

TEST_F(FarmClientTest, ImageOfImpossibleSizeIsRefusedBeforeItsPixels) {
  farm_.images.image = [&](const v1::GetImageRequest&,
                           grpc::ServerWriter<v1::GetImageResponse>* writer) {
    v1::GetImageResponse response = HeaderOf2x1();
    response.mutable_header()->mutable_region()->set_width(1 << 30);
    writer->Write(response);
    return grpc::Status::OK;
  };
  EXPECT_TRUE(absl::IsInternal(MakeClient().GetImage("jobs/1", {}).status()));
}

TEST_F(FarmClientTest, FilmArrivesNodeByNode) {
  TileStatistics node(PixelRect::FromSize(0, 0, 2, 2), {0, 4}, 2);
  const EncodedDelta encoded = EncodeDelta(node, DeltaEncoding::kPacked);
  std::string payload = encoded.payload;
  farm_.images.film = [&](grpc::ServerWriter<v1::GetFilmResponse>* writer) {
    v1::GetFilmResponse response;
    response.mutable_node()->mutable_window()->set_width(2);
    response.mutable_node()->mutable_window()->set_height(2);
    response.mutable_node()->set_sample_end(4);
    response.mutable_node()->set_feature_end(2);
    response.mutable_node()->set_encoding(static_cast<uint32_t>(encoded.encoding));
    response.mutable_node()->set_payload(payload);
    writer->Write(response);
    return grpc::Status::OK;
  };
  const auto nodes = MakeClient().GetFilm("jobs/1");
  ASSERT_TRUE(nodes.ok()) << nodes.status();
  EXPECT_THAT(*nodes, ElementsAre(node));
  payload.pop_back();
  EXPECT_TRUE(absl::IsInternal(MakeClient().GetFilm("jobs/1").status()));
  farm_.images.film = [](grpc::ServerWriter<v1::GetFilmResponse>*) { return grpc::Status::OK; };
  EXPECT_TRUE(absl::IsFailedPrecondition(MakeClient().GetFilm("jobs/1").status()));
}

TEST(JobName, NumberOrResource) {
  EXPECT_EQ(*JobName("7"), "jobs/7");
  EXPECT_EQ(*JobName("jobs/12"), "jobs/12");
  for (const char* text : {"", "jobs/", "x", "jobs/x", "-1", "jobs/1/2"}) {
    EXPECT_FALSE(JobName(text).ok()) << text;
  }
}

}  // namespace
}  // namespace tessera
