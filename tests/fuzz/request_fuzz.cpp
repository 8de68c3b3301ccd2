// What clients and workers ask of a whole server, as bytes on the wire: every call of every service
// but a worker's session (worker_message_fuzz), and the pictures' URLs. Input: a letter for the
// call (kMethods), then its messages, each behind its length in two bytes; for HTTP the target.
// Nobody hangs, and whoever is refused is told why.
#include <grpcpp/generic/generic_stub.h>
#include <google/protobuf/stubs/logging.h>
#include <httplib.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <iterator>
#include <optional>

#include "server/coordinator/job_settings.h"
#include "tests/fuzz/fuzz_target.h"
#include "tests/server/service_fixture.h"

namespace tessera {
namespace {

constexpr const char* kMethods[] = {
    "JobService/CreateJob",       "JobService/GetJob",          "JobService/ListJobs",
    "JobService/WatchJob",        "JobService/PauseJob",        "JobService/ResumeJob",
    "JobService/CancelJob",       "JobService/LookJob",         "JobService/DeleteJob",
    "AssetService/WriteAsset",    "AssetService/ReadAsset",     "AssetService/FindMissingAssets",
    "ImageService/GetImage",      "ImageService/GetFilm",       "WorkerService/ReadFilterInput",
    "WorkerService/ListWorkers",
};
constexpr size_t kCreateJob = 0, kWatchJob = 3, kDeleteJob = 8, kWriteAsset = 9;
constexpr size_t kHttp = std::size(kMethods);
constexpr int kMessagesMax = 16;
constexpr int64_t kPixelsMax = 1 << 16;        // of a job that is asked for: memory is small
constexpr std::chrono::seconds kHangs{20};

void Append(const google::protobuf::Message& message, std::string* out) {
  const std::string bytes = message.SerializeAsString();
  out->push_back(static_cast<char>(bytes.size() & 255));
  out->push_back(static_cast<char>(bytes.size() >> 8));
  out->append(bytes);
}

// nullopt where no message is left.
std::optional<std::string> NextMessage(std::string_view* input) {
  if (input->size() < 2) return std::nullopt;
  const auto* const bytes = reinterpret_cast<const uint8_t*>(input->data());
  const size_t length = std::min<size_t>(bytes[0] + 256u * bytes[1], input->size() - 2);
  std::string message(input->substr(2, length));
  input->remove_prefix(2 + length);
  return message;
}

void Must(const grpc::Status& status) {
  if (status.ok()) return;
  std::fprintf(stderr, "the server answers %d: %s\n", status.error_code(),
               status.error_message().c_str());
  std::abort();
}

// A server with one job that is done, jobs/1.
class Server {
 public:
  Server() {
    ServiceOptions options;
    options.listen = options.http_listen = "127.0.0.1:0";
    options.filter_threads = 1;
    service_ = *Service::Start(options);
    channel_ = grpc::CreateChannel(absl::StrCat("127.0.0.1:", service_->port()),
                                   grpc::InsecureChannelCredentials());
    stub_ = std::make_unique<grpc::GenericStub>(channel_);
    Must(Ask(kWriteAsset, Upload()));
    const SyntheticWorker worker(channel_);
    v1::CreateJobRequest request;
    *request.mutable_settings() = SmallJob();
    std::string create;
    Append(request, &create);
    Must(Ask(kCreateJob, create, false));
    // A watch ends with its job.
    v1::WatchJobRequest watch;
    watch.set_name("jobs/1");
    std::string watched;
    Append(watch, &watched);
    Must(Ask(kWatchJob, watched));
  }

  static v1::JobSettings SmallJob() {
    v1::JobSettings settings = SmallSettings(4);
    settings.mutable_assets(0)->set_sha256(ToBytes(Sha256Of("a scene")));
    settings.mutable_assets(0)->set_size_bytes(7);
    return settings;
  }
  static std::string Upload() {
    v1::WriteAssetRequest request;
    request.mutable_asset()->set_sha256(ToBytes(Sha256Of("a scene")));
    request.mutable_asset()->set_size_bytes(7);
    request.set_chunk("a sc");
    std::string out;
    Append(request, &out);
    v1::WriteAssetRequest rest;
    rest.set_offset_bytes(4);
    rest.set_chunk("ene");
    Append(rest, &out);
    return out;
  }

  // One call; jobs that it makes are deleted, unless they are to stay.
  grpc::Status Ask(size_t method, std::string_view messages, bool deletes = true) {
    grpc::ClientContext context;
    context.set_deadline(std::chrono::system_clock::now() + kHangs);
    grpc::CompletionQueue queue;
    const auto call = stub_->PrepareCall(
        &context, std::string("/tessera.v1.") + kMethods[method], &queue);
    const auto done = [&queue] {
      void* tag = nullptr;
      bool ok = false;
      return queue.Next(&tag, &ok) && ok;
    };
    call->StartCall(nullptr);
    bool is_open = done();
    // Calls other than uploads have one message: what is wrong about that, gRPC deals with.
    const int messages_max = method == kWriteAsset ? kMessagesMax : 1;
    for (int i = 0; is_open && i < messages_max; ++i) {
      const std::optional<std::string> message = NextMessage(&messages);
      if (!message && method == kWriteAsset) break;
      const grpc::Slice slice(message.value_or(""));
      call->Write(grpc::ByteBuffer(&slice, 1), nullptr);
      is_open = done();
    }
    call->WritesDone(nullptr);
    done();
    grpc::ByteBuffer answer, first;
    for (bool is_first = true;; is_first = false) {
      call->Read(&answer, nullptr);
      if (!done()) break;
      if (is_first) first = answer;
    }
    grpc::Status status;
    call->Finish(&status, nullptr);
    done();
    v1::Job job;
    if (method == kCreateJob && status.ok() && deletes && Parse(first, &job)) {
      v1::DeleteJobRequest request;
      request.set_name(job.name());
      std::string again;
      Append(request, &again);
      if (job.name() != "jobs/1") Must(Ask(kDeleteJob, again));
    }
    return status;
  }

  // The HTTP status; 0 = no answer.
  int AskHttp(const std::string& target) const {
    httplib::Client client("127.0.0.1", service_->http_port());
    const httplib::Result result = client.Get(target.c_str());
    return result ? result->status : 0;
  }

 private:
  static bool Parse(const grpc::ByteBuffer& buffer, google::protobuf::Message* message) {
    grpc::Slice slice;
    return buffer.DumpToSingleSlice(&slice).ok() &&
           message->ParseFromArray(slice.begin(), static_cast<int>(slice.size()));
  }

  std::unique_ptr<Service> service_;
  std::shared_ptr<grpc::Channel> channel_;
  std::unique_ptr<grpc::GenericStub> stub_;
};

Server& TheServer() {
  static Server server;
  return server;
}

// Which call, and whether it is one.
std::optional<size_t> MethodOf(std::string_view input) {
  if (input.empty() || input[0] < 'a' || input[0] > static_cast<char>('a' + kHttp)) {
    return std::nullopt;
  }
  return static_cast<size_t>(input[0] - 'a');
}

// Whether it asks for a job whose film a fuzzer's memory has no room for, or for the deletion of
// the job that all others ask for.
bool IsLeftOut(size_t method, std::string_view messages) {
  const std::optional<std::string> first = NextMessage(&messages);
  if (method == kCreateJob && first) {
    v1::CreateJobRequest request;
    return request.ParseFromString(*first) &&
           int64_t{request.settings().width()} * request.settings().height() > kPixelsMax;
  }
  v1::DeleteJobRequest request;
  return method == kDeleteJob && first && request.ParseFromString(*first) &&
         ParseJobName(request.name()).value_or(0) == 1;
}

std::string Seed(size_t method, const google::protobuf::Message& message) {
  std::string seed(1, static_cast<char>('a' + method));
  Append(message, &seed);
  return seed;
}

template <typename Request>
std::string SeedOfJob(size_t method) {
  Request request;
  request.set_name("jobs/1");
  return Seed(method, request);
}

}  // namespace

bool IsTaken(std::string_view input) {
  const std::optional<size_t> method = MethodOf(input);
  if (!method) return false;
  input.remove_prefix(1);
  if (*method == kHttp) return TheServer().AskHttp(std::string(input)) == 200;
  const grpc::Status status = TheServer().Ask(*method, input);
  // Of a job that is done, and a lease that nobody has: read and understood.
  return status.ok() || status.error_code() == grpc::FAILED_PRECONDITION ||
         status.error_code() == grpc::NOT_FOUND;
}

void FuzzOne(std::string_view input) {
  const std::optional<size_t> method = MethodOf(input);
  if (!method) return;
  input.remove_prefix(1);
  if (*method == kHttp) {
    // Without a leading '/' it is no request; a longer one than 8 KiB is not read.
    (void)TheServer().AskHttp("/" + std::string(input.substr(0, 4096)));
    if (TheServer().AskHttp("/healthz") != 200) std::abort();
    return;
  }
  if (IsLeftOut(*method, input)) return;
  const grpc::Status status = TheServer().Ask(*method, input);
  if (status.ok()) return;
  // What is no message at all is refused by gRPC itself, without a word.
  if (status.error_code() == grpc::UNIMPLEMENTED) return;
  if (status.error_message().empty() || status.error_code() == grpc::UNKNOWN ||
      status.error_code() == grpc::DEADLINE_EXCEEDED) {
    std::fprintf(stderr, "%s, %zu bytes\n", kMethods[*method], input.size());
    Must(status);
  }
}

std::vector<std::string> FuzzSeeds() {
  google::protobuf::SetLogHandler(nullptr);  // what is no UTF-8 is no news here
  v1::CreateJobRequest create;
  *create.mutable_settings() = Server::SmallJob();
  create.set_request_id("once");
  v1::ListJobsRequest list;
  list.set_page_size(3);
  v1::WatchJobRequest watch;
  watch.set_name("jobs/1");
  watch.set_only_changes(true);
  watch.mutable_min_interval()->set_nanos(1000);
  watch.mutable_from_revision()->set_counter(1);
  *watch.mutable_region() = RegionProto({2, 3, 10, 9});
  v1::LookJobRequest look;
  look.set_name("jobs/1");
  *look.mutable_region() = RegionProto({2, 3, 10, 9});
  v1::ReadAssetRequest read;
  read.set_sha256(ToBytes(Sha256Of("a scene")));
  v1::FindMissingAssetsRequest missing;
  missing.add_assets()->set_sha256(read.sha256());
  v1::GetImageRequest image;
  image.set_job("jobs/1");
  image.add_layers("raw");
  *image.mutable_region() = RegionProto({2, 3, 10, 9});
  v1::GetFilmRequest film;
  film.set_job("jobs/1");
  v1::ReadFilterInputRequest input;
  input.set_worker("workers/1");
  input.set_lease_id(1);
  const std::string http(1, static_cast<char>('a' + kHttp));
  return {Seed(kCreateJob, create),
          SeedOfJob<v1::GetJobRequest>(1),
          Seed(2, list),
          Seed(3, watch),
          SeedOfJob<v1::PauseJobRequest>(4),
          SeedOfJob<v1::ResumeJobRequest>(5),
          SeedOfJob<v1::CancelJobRequest>(6),
          Seed(7, look),
          "j" + Server::Upload(),
          Seed(10, read),
          Seed(11, missing),
          Seed(12, image),
          Seed(13, film),
          Seed(14, input),
          Seed(15, v1::ListWorkersRequest()),
          http + "/jobs/1/image.png?layer=raw&region=2,3,10,7&exposure=1.5",
          http + "/jobs"};
}

}  // namespace tessera
