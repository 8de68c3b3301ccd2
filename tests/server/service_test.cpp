#include "server/service.h"

#include <cstring>
#include <filesystem>
#include <fstream>
#include <regex>
#include <set>
#include <sstream>

#include <gmock/gmock.h>
#include <httplib.h>

#include "core/film/frame_planes.h"
#include "tests/server/service_fixture.h"

namespace tessera {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ServiceTest = ServiceFixture;

std::string ExpectedDigest(const v1::JobSettings& s, int64_t spp) {
  const TileGrid grid(RegionOf(s), s.tile_size());
  return ToBytes(SyntheticFilm(s.seed(), grid, spp, FeatureEndOf(s.feature_spp())).Digest());
}

TEST_F(ServiceTest, SubmitWatchFetch) {
  StartService();
  const v1::JobSettings settings = UploadedSettings(21);
  v1::Job job;
  ASSERT_TRUE(Create(settings, &job).ok());
  EXPECT_EQ(job.name(), "jobs/1");
  SyntheticWorker worker(channel), second(service->InProcessChannel());
  v1::Job last;
  EXPECT_GE(Watch(job.name(), &last), 1);
  EXPECT_EQ(last.state(), v1::JOB_STATE_DONE);
  EXPECT_EQ(last.digest(), ExpectedDigest(settings, 21));
  EXPECT_EQ(last.progress().samples(), 21 * 190);

  v1::GetImageRequest request;
  request.set_job(job.name());
  request.add_layers("raw");
  request.add_layers("samples");
  request.set_wait_for_filter(true);
  request.mutable_region()->set_x(3);
  request.mutable_region()->set_y(2);
  request.mutable_region()->set_width(9);
  request.mutable_region()->set_height(5);
  grpc::ClientContext context;
  const auto reader = images->GetImage(&context, request);
  v1::GetImageResponse response;
  std::string bytes;
  v1::ImageHeader header;
  while (reader->Read(&response)) {
    if (response.has_header()) header = response.header();
    bytes += response.chunk();
  }
  ASSERT_TRUE(reader->Finish().ok());
  ASSERT_EQ(header.layers_size(), 2);
  EXPECT_EQ(header.layers(0).channels_size(), 3);
  EXPECT_TRUE(header.layers(1).is_uint());
  ASSERT_EQ(bytes.size(), 4u * 45u * 4u);
  // The mean of pixel (3, 2), red, as the film has it.
  FramePlanes planes(RegionOf(settings));
  const TileGrid grid(RegionOf(settings), settings.tile_size());
  const Film film = SyntheticFilm(0, grid, 21);
  for (int64_t tile = 0; tile < grid.num_tiles(); ++tile) planes.Resolve(film.Fold(tile));
  float red = 0;
  std::memcpy(&red, bytes.data(), sizeof(red));
  EXPECT_EQ(red, planes.color[0][static_cast<size_t>(planes.bounds.IndexOf(3, 2))]);
  uint32_t samples = 0;
  std::memcpy(&samples, bytes.data() + 3 * 45 * 4, sizeof(samples));
  EXPECT_EQ(samples, 21u);
}

TEST_F(ServiceTest, TheFilmOfAJobIsFetchedWhole) {
  StartService();
  const v1::JobSettings settings = UploadedSettings(5);
  v1::Job job;
  ASSERT_TRUE(Create(settings, &job).ok());
  SyntheticWorker worker(channel);
  v1::Job last;
  Watch(job.name(), &last);
  EXPECT_EQ(ToBytes(FetchFilm(last).Digest()), last.digest());
}

TEST_F(ServiceTest, CancelEndsTheWatch) {
  StartService();
  v1::Job job;
  ASSERT_TRUE(Create(UploadedSettings(1 << 20), &job).ok());
  grpc::ClientContext watch_context;
  v1::WatchJobRequest watch;
  watch.set_name(job.name());
  const auto reader = jobs->WatchJob(&watch_context, watch);
  v1::Job update;
  ASSERT_TRUE(reader->Read(&update));
  EXPECT_EQ(update.state(), v1::JOB_STATE_QUEUED);
  grpc::ClientContext context;
  v1::CancelJobRequest request;
  request.set_name(job.name());
  ASSERT_TRUE(jobs->CancelJob(&context, request, &job).ok());
  while (reader->Read(&update)) {
  }
  EXPECT_TRUE(reader->Finish().ok());
  EXPECT_EQ(update.state(), v1::JOB_STATE_CANCELLED);
}

TEST_F(ServiceTest, AWatcherSaysWhatItLooksAt) {
  StartService();
  v1::Job job;
  ASSERT_TRUE(Create(UploadedSettings(2), &job).ok());
  const auto watch = [&](int x, int width, int height) {
    grpc::ClientContext context;
    v1::WatchJobRequest request;
    request.set_name(job.name());
    request.mutable_region()->set_x(x);
    request.mutable_region()->set_width(width);
    request.mutable_region()->set_height(height);
    const auto reader = jobs->WatchJob(&context, request);
    v1::Job state;
    while (reader->Read(&state)) {
    }
    return reader->Finish();
  };
  const grpc::Status outside = watch(1, job.settings().width(), 4);
  EXPECT_EQ(outside.error_code(), grpc::INVALID_ARGUMENT);
  EXPECT_NE(outside.error_message().find("region"), std::string::npos);
  EXPECT_EQ(watch(0, 4, 0).error_code(), grpc::INVALID_ARGUMENT);
  SyntheticWorker worker(channel);
  EXPECT_TRUE(watch(1, 4, 4).ok());
  EXPECT_TRUE(watch(0, 0, 0).ok()) << "progress alone";
}

TEST_F(ServiceTest, ASlowWatcherSkipsStates) {
  StartService();
  v1::Job job;
  ASSERT_TRUE(Create(UploadedSettings(256), &job).ok());
  // Never read until the job is done: what waits for this watcher is one state, not hundreds.
  grpc::ClientContext slow_context;
  v1::WatchJobRequest request;
  request.set_name(job.name());
  request.mutable_min_interval()->set_nanos(1);
  const auto slow = jobs->WatchJob(&slow_context, request);
  SyntheticWorker worker(channel);
  v1::Job last;
  Watch(job.name(), &last);
  ASSERT_EQ(last.state(), v1::JOB_STATE_DONE);
  v1::Job state;
  int64_t count = 0;
  while (slow->Read(&state)) ++count;
  EXPECT_TRUE(slow->Finish().ok());
  EXPECT_EQ(state.state(), v1::JOB_STATE_DONE);
  EXPECT_LT(count, static_cast<int64_t>(last.revision().counter()));
}

TEST_F(ServiceTest, BadRequestsNameTheFieldAndHarmNothing) {
  StartService();
  v1::JobSettings settings = UploadedSettings(2);
  v1::Job job;
  settings.set_width(0);
  grpc::Status status = Create(settings, &job);
  EXPECT_EQ(status.error_code(), grpc::INVALID_ARGUMENT);
  EXPECT_NE(status.error_message().find("width"), std::string::npos);
  settings = UploadedSettings(2);
  settings.mutable_assets(0)->set_sha256(std::string(32, 'z'));
  status = Create(settings, &job);
  EXPECT_EQ(status.error_code(), grpc::FAILED_PRECONDITION);
  EXPECT_NE(status.error_message().find("7a7a7a"), std::string::npos) << status.error_message();
  settings.set_scene_name(std::string(5 << 20, 'x'));
  EXPECT_EQ(Create(settings, &job).error_code(), grpc::RESOURCE_EXHAUSTED) << "5 MiB at once";
  grpc::ClientContext context;
  v1::GetJobRequest get;
  get.set_name("jobs/../1");
  EXPECT_EQ(jobs->GetJob(&context, get, &job).error_code(), grpc::INVALID_ARGUMENT);
  EXPECT_EQ(Upload("wrong", Sha256Of("right")).error_code(), grpc::DATA_LOSS);

  // A worker that sends nonsense loses its session; the job goes on with another.
  ASSERT_TRUE(Create(UploadedSettings(2), &job).ok());
  grpc::ClientContext bad_context;
  const auto stub = v1::WorkerService::NewStub(channel);
  const auto stream = stub->Work(&bad_context);
  v1::WorkerMessage message;
  message.mutable_hello()->set_threads(1);
  message.mutable_hello()->set_version(kVersion);
  message.mutable_hello()->add_isa_classes("x86-64-v3");
  message.mutable_hello()->add_arithmetic("00000000000000a1");
  stream->Write(message);
  v1::CoordinatorMessage down;
  while (stream->Read(&down) && !down.has_lease()) {
  }
  *message.mutable_delta()->mutable_window() = down.lease().window();
  message.mutable_delta()->set_job(job.name());
  message.mutable_delta()->set_sample_end(2);
  message.mutable_delta()->set_payload("nonsense");
  stream->Write(message);
  while (stream->Read(&down)) {
  }
  EXPECT_EQ(stream->Finish().error_code(), grpc::INVALID_ARGUMENT);
  SyntheticWorker worker(channel);
  v1::Job last;
  Watch(job.name(), &last);
  EXPECT_EQ(last.state(), v1::JOB_STATE_DONE);
}

TEST_F(ServiceTest, PicturesOverHttpHaveETags) {
  StartService();
  const v1::JobSettings settings = UploadedSettings(4);
  v1::Job job;
  ASSERT_TRUE(Create(settings, &job).ok());
  SyntheticWorker worker(channel);
  v1::Job last;
  Watch(job.name(), &last);
  httplib::Client client("127.0.0.1", service->http_port());
  EXPECT_EQ(client.Get("/healthz")->status, 200);
  EXPECT_EQ(client.Get("/")->status, 200);
  EXPECT_NE(client.Get("/jobs")->body.find("jobs/1"), std::string::npos);
  EXPECT_NE(client.Get("/jobs/1")->body.find("JOB_STATE_DONE"), std::string::npos);
  const auto picture = client.Get("/jobs/1/image.png?layer=raw&region=1,1,8,8&exposure=1");
  EXPECT_EQ(picture->status, 200);
  EXPECT_EQ(picture->body.substr(1, 3), "PNG");
  const httplib::Headers headers = {{"If-None-Match", picture->get_header_value("ETag")}};
  EXPECT_EQ(client.Get("/jobs/1/image.png?layer=raw", headers)->status, 304);
  for (const char* layer : {"final", "albedo", "normal", "Z", "id", "samples", "variance"}) {
    EXPECT_EQ(client.Get((std::string("/jobs/1/image.png?layer=") + layer).c_str())->status, 200);
  }
  EXPECT_EQ(client.Get("/jobs/2/image.png")->status, 404);
  EXPECT_EQ(client.Get("/jobs/1/image.png?layer=magic")->status, 400);
  EXPECT_EQ(client.Get("/jobs/1/image.png?region=0,0,9999,1")->status, 400);
}

TEST_F(ServiceTest, MetricsCountWhatHappened) {
  StartService();
  const v1::JobSettings settings = UploadedSettings(4);
  v1::Job job;
  ASSERT_TRUE(Create(settings, &job).ok());
  httplib::Client client("127.0.0.1", service->http_port());
  EXPECT_THAT(client.Get("/metrics")->body,
              AllOf(HasSubstr("\ntessera_jobs{state=\"queued\"} 1\n"),
                    HasSubstr("\ntessera_workers 0\n"), HasSubstr("\ntessera_samples_total 0\n"),
                    HasSubstr(absl::StrCat("\ntessera_samples_waiting{state=\"queued\"} ",
                                           settings.width() * settings.height() * 4, "\n"))));
  SyntheticWorker worker(channel);
  v1::Job last;
  Watch(job.name(), &last);
  const int64_t samples = int64_t{settings.width()} * settings.height() * 4;
  const std::string text = client.Get("/metrics")->body;
  EXPECT_THAT(text, AllOf(HasSubstr("\ntessera_jobs{state=\"done\"} 1\n"),
                          HasSubstr("\ntessera_jobs{state=\"queued\"} 0\n"),
                          HasSubstr("\ntessera_workers 1\n"), HasSubstr("\ntessera_leases 0\n")));
  EXPECT_THAT(text, HasSubstr(absl::StrCat("\ntessera_samples_total ", samples, "\n")));
  EXPECT_THAT(text, HasSubstr("host=\"synthetic\"} " + std::to_string(samples)));
  EXPECT_THAT(text, HasSubstr("# TYPE tessera_first_picture_seconds summary"));
  EXPECT_THAT(text, HasSubstr("\ntessera_first_picture_seconds_count 1\n"));
  EXPECT_THAT(text, HasSubstr("\ntessera_filter_round_seconds_bucket{le=\"+Inf\"} "));
  EXPECT_THAT(text, HasSubstr("\ntessera_samples_waiting{state=\"queued\"} 0\n"));
}

// Names of the server's metrics in a text, without the suffixes of a summary's lines.
std::set<std::string> MetricNames(const std::string& text, const std::string& pattern) {
  std::set<std::string> names;
  const std::regex regex(pattern);
  for (auto it = std::sregex_iterator(text.begin(), text.end(), regex);
       it != std::sregex_iterator(); ++it) {
    names.insert((*it)[1]);
  }
  return names;
}

TEST_F(ServiceTest, TheManualListsEveryMetricAndNoOther) {
  std::ifstream file(std::string(TESSERA_DOCS) + "/operations.md");
  std::stringstream manual;
  manual << file.rdbuf();
  std::string text = manual.str();
  const size_t begin = text.find("`GET /metrics`");
  ASSERT_NE(begin, std::string::npos);
  text = text.substr(begin, text.find("`GET /healthz`") - begin);
  StartService();
  SyntheticWorker worker(channel);  // families without a value are not written
  v1::Job job, last;
  ASSERT_TRUE(Create(UploadedSettings(1), &job).ok());
  Watch(job.name(), &last);
  httplib::Client client("127.0.0.1", service->http_port());
  EXPECT_EQ(MetricNames(text, "`((?:tessera|process)_[a-z_]+)(?:\\{[a-z,]+\\})?`"),
            MetricNames(client.Get("/metrics")->body, "# TYPE ([a-z_]+) "));
}

TEST_F(ServiceTest, JobsSurviveARestart) {
  ServiceOptions options;
  options.data_dir = testing::TempDir() + "/service-" + std::to_string(::getpid());
  std::filesystem::remove_all(options.data_dir);
  StartService(options);
  EXPECT_TRUE(absl::IsUnavailable(Service::Start(options).status())) << "the folder is locked";
  v1::Job done, queued, last;
  ASSERT_TRUE(Create(UploadedSettings(3), &done).ok());
  {
    SyntheticWorker worker(channel);
    Watch(done.name(), &last);
  }
  v1::JobSettings other = UploadedSettings(6);
  other.set_seed(3);
  ASSERT_TRUE(Create(other, &queued).ok());
  service->Shutdown();
  service.reset();
  StartService(options);
  v1::Job restored;
  EXPECT_EQ(Watch(done.name(), &restored), 1);
  EXPECT_EQ(restored.state(), v1::JOB_STATE_DONE);
  EXPECT_EQ(restored.digest(), last.digest());
  EXPECT_EQ(restored.revision().incarnation(), 2u);
  const Film film = FetchFilm(restored);
  EXPECT_EQ(ToBytes(film.Digest()), last.digest());
  SyntheticWorker worker(channel);
  Watch(queued.name(), &last);
  EXPECT_EQ(last.digest(), ExpectedDigest(other, 6));
  std::filesystem::remove_all(options.data_dir);
}

// A watch of changes goes on at the revision that it had of a server that is no more.
TEST_F(ServiceTest, AWatchResumedAfterARestartBeginsWithTheWholeJob) {
  ServiceOptions options;
  options.data_dir = testing::TempDir() + "/watch-" + std::to_string(::getpid());
  std::filesystem::remove_all(options.data_dir);
  StartService(options);
  v1::Job created, seen, job;
  ASSERT_TRUE(Create(UploadedSettings(1 << 20), &created).ok());
  const auto watch = [&](grpc::ClientContext* context, const v1::Revision& from) {
    v1::WatchJobRequest request;
    request.set_name(created.name());
    request.set_only_changes(true);
    request.mutable_min_interval()->set_nanos(1);
    *request.mutable_from_revision() = from;
    return jobs->WatchJob(context, request);
  };
  {
    grpc::ClientContext context, pause_context;
    const auto before = watch(&context, {});
    SyntheticWorker worker(channel);
    while (!(seen.has_scene() && job.progress().samples() > 0) && before->Read(&job)) {
      seen.MergeFrom(job);
    }
    v1::PauseJobRequest pause;
    pause.set_name(created.name());
    ASSERT_TRUE(jobs->PauseJob(&pause_context, pause, &job).ok());
    service->Shutdown();
    while (before->Read(&job)) {
    }
    EXPECT_EQ(before->Finish().error_code(), grpc::UNAVAILABLE) << "that it may be resumed";
  }
  service.reset();
  StartService(options);
  // It may have heard of more changes than the new server has made so far.
  v1::Revision from = job.revision();
  from.set_counter(from.counter() + 1000);
  grpc::ClientContext context, cancel_context;
  const auto after = watch(&context, from);
  v1::Job last;
  ASSERT_TRUE(after->Read(&last));
  EXPECT_EQ(last.state(), v1::JOB_STATE_PAUSED);
  EXPECT_GT(last.progress().samples(), 0);
  EXPECT_EQ(last.revision().incarnation(), from.incarnation() + 1);
  EXPECT_EQ(last.settings().SerializeAsString(), created.settings().SerializeAsString());
  EXPECT_EQ(last.scene().triangles(), 12);
  v1::CancelJobRequest cancel;
  cancel.set_name(created.name());
  ASSERT_TRUE(jobs->CancelJob(&cancel_context, cancel, &job).ok());
  for (v1::Job next; after->Read(&next); last = next) {
    EXPECT_EQ(next.revision().incarnation(), last.revision().incarnation());
    EXPECT_GT(next.revision().counter(), last.revision().counter());
    EXPECT_FALSE(next.has_settings() || next.has_scene()) << "they are known";
  }
  EXPECT_TRUE(after->Finish().ok());
  EXPECT_EQ(last.state(), v1::JOB_STATE_CANCELLED);
  std::filesystem::remove_all(options.data_dir);
}

TEST_F(ServiceTest, ALostFilmIsSaidToBeLost) {
  ServiceOptions options;
  options.data_dir = testing::TempDir() + "/lost-" + std::to_string(::getpid());
  std::filesystem::remove_all(options.data_dir);
  StartService(options);
  v1::Job done, last;
  ASSERT_TRUE(Create(UploadedSettings(3), &done).ok());
  {
    SyntheticWorker worker(channel);
    Watch(done.name(), &last);
  }
  service->Shutdown();
  service.reset();
  std::filesystem::resize_file(options.data_dir + "/films/1.film", 100);
  StartService(options);
  grpc::ClientContext film_context, image_context;
  v1::GetFilmRequest film;
  film.set_job(done.name());
  v1::GetFilmResponse node;
  const auto nodes = images->GetFilm(&film_context, film);
  EXPECT_FALSE(nodes->Read(&node));
  EXPECT_EQ(nodes->Finish().error_code(), grpc::DATA_LOSS);
  v1::GetImageRequest image;
  image.set_job(done.name());
  v1::GetImageResponse part;
  const auto parts = images->GetImage(&image_context, image);
  EXPECT_FALSE(parts->Read(&part)) << "no black picture";
  EXPECT_EQ(parts->Finish().error_code(), grpc::UNAVAILABLE);
  std::filesystem::remove_all(options.data_dir);
}

TEST(ServiceStart, RefusesPlaintextToTheWorldAndPortsInUse) {
  ServiceOptions options;
  for (const char* const address : {"0.0.0.0:0", "127.example.com:0", "localhost.example.com:0"}) {
    options.listen = address;
    const absl::Status plaintext = Service::Start(options).status();
    EXPECT_TRUE(absl::IsInvalidArgument(plaintext)) << plaintext;
    EXPECT_NE(plaintext.message().find("--insecure"), absl::string_view::npos);
  }
  options.listen = "127.0.0.1:0";
  const auto first = Service::Start(options);
  ASSERT_TRUE(first.ok());
  options.listen = absl::StrCat("127.0.0.1:", (*first)->port());
  EXPECT_TRUE(absl::IsUnavailable(Service::Start(options).status()));
}

TEST(ServiceStart, AnHttpPortInUseIsNamedWithTheRemedy) {
  ServiceOptions options;
  options.listen = options.http_listen = "127.0.0.1:0";
  const auto first = Service::Start(options);
  ASSERT_TRUE(first.ok());
  EXPECT_GT((*first)->http_port(), 0);
  options.http_listen = absl::StrCat("127.0.0.1:", (*first)->http_port());
  const absl::Status in_use = Service::Start(options).status();
  EXPECT_TRUE(absl::IsUnavailable(in_use));
  EXPECT_NE(in_use.message().find("--http off"), absl::string_view::npos) << in_use;
  options.http_listen = "off";
  const auto second = Service::Start(options);
  ASSERT_TRUE(second.ok());
  EXPECT_EQ((*second)->http_port(), 0);
}

}  // namespace
}  // namespace tessera
