// A service with TLS, tokens and worker certificates, over real gRPC and HTTPS.
#include <gmock/gmock.h>
#include <grpcpp/generic/generic_stub.h>
#include <gtest/gtest.h>
#include <httplib.h>

#include "tests/server/security/temporary_certificates.h"
#include "tests/server/service_fixture.h"

namespace tessera {
namespace {

using ::testing::HasSubstr;

constexpr char kTokens[] =
    "view   lena   0123456789abcdef\n"
    "submit sam    fedcba9876543210\n"
    "submit sue    cccccccccccccccc\n"
    "admin  ada    aaaaaaaaaaaaaaaa\n"
    "worker rack-1 bbbbbbbbbbbbbbbb\n";
constexpr char kLena[] = "0123456789abcdef";
constexpr char kSam[] = "fedcba9876543210";
constexpr char kSue[] = "cccccccccccccccc";
constexpr char kAda[] = "aaaaaaaaaaaaaaaa";
constexpr char kRack[] = "bbbbbbbbbbbbbbbb";

class SecuredServiceTest : public ServiceFixture {
 protected:
  void Start(bool tokens, bool certificates) {
    ServiceOptions options;
    options.tls.cert = files_.Path("server.pem");
    options.tls.key = files_.Path("server.key");
    if (certificates) options.tls.client_ca = files_.Path("ca.pem");
    if (tokens) options.token_file = files_.Write("tokens", kTokens);
    StartService(options);
  }
  std::shared_ptr<grpc::Channel> Dial(bool with_certificate) {
    grpc::SslCredentialsOptions options;
    options.pem_root_certs = files_.Read("ca.pem");
    if (with_certificate) {
      options.pem_cert_chain = files_.Read("worker.pem");
      options.pem_private_key = files_.Read("worker.key");
    }
    grpc::ChannelArguments arguments;
    arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
    return grpc::CreateCustomChannel("127.0.0.1:" + std::to_string(service->port()),
                                     grpc::SslCredentials(options), arguments);
  }
  static void Identify(grpc::ClientContext* context, const std::string& token) {
    context->set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(20));
    if (!token.empty()) context->AddMetadata("authorization", "Bearer " + token);
  }
  // One call of any kind with an empty request.
  static grpc::Status CallEmpty(const std::shared_ptr<grpc::Channel>& channel,
                                const std::string& method, const std::string& token) {
    grpc::GenericStub stub(channel);
    grpc::ClientContext context;
    Identify(&context, token);
    grpc::CompletionQueue queue;
    const auto call = stub.PrepareCall(&context, method, &queue);
    void* tag = nullptr;
    bool ok = false;
    call->StartCall(nullptr);
    queue.Next(&tag, &ok);
    if (ok) {
      const grpc::Slice nothing;
      call->WriteLast(grpc::ByteBuffer(&nothing, 1), {}, nullptr);
      queue.Next(&tag, &ok);
    }
    for (grpc::ByteBuffer reply; ok;) {
      call->Read(&reply, nullptr);
      queue.Next(&tag, &ok);
    }
    grpc::Status status;
    call->Finish(&status, nullptr);
    queue.Next(&tag, &ok);
    queue.Shutdown();
    while (queue.Next(&tag, &ok)) {
    }
    return status;
  }
  grpc::Status CreateAs(const std::string& token, v1::Job* job) {
    grpc::ClientContext context;
    Identify(&context, token);
    v1::CreateJobRequest request;
    *request.mutable_settings() = settings_;
    return v1::JobService::NewStub(Dial(false))->CreateJob(&context, request, job);
  }
  grpc::Status CancelAs(const std::string& token, const std::string& name) {
    grpc::ClientContext context;
    Identify(&context, token);
    v1::CancelJobRequest request;
    request.set_name(name);
    v1::Job job;
    return v1::JobService::NewStub(Dial(false))->CancelJob(&context, request, &job);
  }
  void UploadScene(const std::string& token) {
    settings_ = SmallSettings(4);
    settings_.mutable_assets(0)->set_sha256(ToBytes(Sha256Of("a scene")));
    settings_.mutable_assets(0)->set_size_bytes(7);
    grpc::ClientContext context;
    Identify(&context, token);
    v1::WriteAssetResponse response;
    const auto writer = v1::AssetService::NewStub(Dial(false))->WriteAsset(&context, &response);
    v1::WriteAssetRequest request;
    request.mutable_asset()->set_sha256(settings_.assets(0).sha256());
    request.mutable_asset()->set_size_bytes(7);
    request.set_chunk("a scene");
    writer->Write(request);
    writer->WritesDone();
    ASSERT_TRUE(writer->Finish().ok());
  }

  TemporaryCertificates files_;
  v1::JobSettings settings_;
};

TEST_F(SecuredServiceTest, EveryMethodAsksForATokenAndItsRole) {
  Start(true, false);
  const auto anonymous = Dial(false);
  int num_methods = 0;
  for (const google::protobuf::FileDescriptor* file :
       {v1::CreateJobRequest::descriptor()->file(), v1::GetImageRequest::descriptor()->file(),
        v1::WriteAssetRequest::descriptor()->file(), v1::WorkerMessage::descriptor()->file()}) {
    for (int s = 0; s < file->service_count(); ++s) {
      for (int m = 0; m < file->service(s)->method_count(); ++m) {
        const std::string method =
            "/" + file->service(s)->full_name() + "/" + file->service(s)->method(m)->name();
        const auto code = [&](const char* token) {
          return CallEmpty(anonymous, method, token).error_code();
        };
        EXPECT_EQ(code(""), grpc::StatusCode::UNAUTHENTICATED) << method;
        EXPECT_EQ(code("not-one-of-them!"), grpc::StatusCode::UNAUTHENTICATED) << method;
        const bool is_workers = method.ends_with("/Work") || method.ends_with("/ReadAsset") ||
                                method.ends_with("/ReadFilterInput");
        EXPECT_EQ(code(is_workers ? kAda : kRack), grpc::StatusCode::PERMISSION_DENIED) << method;
        ++num_methods;
      }
    }
  }
  EXPECT_GE(num_methods, 15);
  EXPECT_TRUE(CallEmpty(anonymous, "/grpc.health.v1.Health/Check", "").ok());
}

TEST_F(SecuredServiceTest, WhoSeesSubmitsAndSteers) {
  Start(true, false);
  UploadScene(kSam);
  v1::Job job;
  EXPECT_EQ(CreateAs(kLena, &job).error_code(), grpc::StatusCode::PERMISSION_DENIED);
  ASSERT_TRUE(CreateAs(kSam, &job).ok());
  EXPECT_EQ(job.owner(), "sam");
  const grpc::Status not_hers = CancelAs(kSue, job.name());
  EXPECT_EQ(not_hers.error_code(), grpc::StatusCode::PERMISSION_DENIED);
  EXPECT_THAT(not_hers.error_message(), HasSubstr("belongs to 'sam'"));
  EXPECT_EQ(CancelAs(kLena, job.name()).error_code(), grpc::StatusCode::PERMISSION_DENIED);
  EXPECT_TRUE(CancelAs(kSam, job.name()).ok());
  v1::Job second;
  ASSERT_TRUE(CreateAs(kSam, &second).ok());
  EXPECT_TRUE(CancelAs(kAda, second.name()).ok());
}

TEST_F(SecuredServiceTest, WorkersNeedACertificateOrAToken) {
  Start(true, true);
  const auto code = [&](bool certificate, const char* token) {
    return CallEmpty(Dial(certificate), "/tessera.v1.WorkerService/Work", token).error_code();
  };
  EXPECT_EQ(code(false, ""), grpc::StatusCode::UNAUTHENTICATED);
  EXPECT_EQ(code(false, kSam), grpc::StatusCode::PERMISSION_DENIED);
  // Past the door: the empty first message is no Hello.
  EXPECT_EQ(code(true, ""), grpc::StatusCode::INVALID_ARGUMENT);
  EXPECT_EQ(code(false, kRack), grpc::StatusCode::INVALID_ARGUMENT);
  // A worker's certificate is no client's token.
  EXPECT_EQ(CallEmpty(Dial(true), "/tessera.v1.JobService/ListJobs", "").error_code(),
            grpc::StatusCode::UNAUTHENTICATED);
}

TEST_F(SecuredServiceTest, WithCertificatesAloneTheyAreForClientsToo) {
  Start(false, true);
  EXPECT_TRUE(CallEmpty(Dial(true), "/tessera.v1.JobService/ListJobs", "").ok());
  const grpc::Status refused = CallEmpty(Dial(false), "/tessera.v1.JobService/ListJobs", "");
  EXPECT_EQ(refused.error_code(), grpc::StatusCode::UNAUTHENTICATED);
  EXPECT_THAT(refused.error_message(), HasSubstr("--cert"));
}

TEST_F(SecuredServiceTest, AWorkerRendersOverTls) {
  Start(true, true);
  UploadScene(kSam);
  v1::Job job;
  ASSERT_TRUE(CreateAs(kSam, &job).ok());
  SyntheticWorker worker(Dial(true));
  grpc::ClientContext context;
  Identify(&context, kLena);
  v1::WatchJobRequest request;
  request.set_name(job.name());
  const auto reader = v1::JobService::NewStub(Dial(false))->WatchJob(&context, request);
  while (reader->Read(&job)) {
  }
  EXPECT_TRUE(reader->Finish().ok());
  EXPECT_EQ(job.state(), v1::JOB_STATE_DONE) << job.error();
}

TEST_F(SecuredServiceTest, PlaintextAndUnknownAuthoritiesGetNoAnswer) {
  Start(false, false);
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(20));
  v1::ListJobsResponse response;
  EXPECT_EQ(jobs->ListJobs(&context, {}, &response).error_code(), grpc::StatusCode::UNAVAILABLE);
  files_.Authority("stranger");
  grpc::SslCredentialsOptions options;
  options.pem_root_certs = files_.Read("stranger.pem");
  const auto stranger = grpc::CreateChannel("127.0.0.1:" + std::to_string(service->port()),
                                            grpc::SslCredentials(options));
  EXPECT_EQ(CallEmpty(stranger, "/tessera.v1.JobService/ListJobs", "").error_code(),
            grpc::StatusCode::UNAVAILABLE);
}

TEST_F(SecuredServiceTest, PicturesOverHttpsAskForAToken) {
  Start(true, false);
  httplib::SSLClient client("127.0.0.1", service->http_port());
  client.set_ca_cert_path(files_.Path("ca.pem").c_str());
  client.enable_server_certificate_verification(true);
  auto reply = client.Get("/jobs");
  ASSERT_TRUE(reply);
  EXPECT_EQ(reply->status, 401);
  EXPECT_THAT(reply->get_header_value("WWW-Authenticate"), HasSubstr("Basic"));
  EXPECT_EQ(client.Get("/healthz")->status, 200);
  client.set_basic_auth("lena", kLena);
  EXPECT_EQ(client.Get("/jobs")->status, 200);
  client.set_basic_auth("rack", kRack);
  EXPECT_EQ(client.Get("/jobs")->status, 403);
}

TEST_F(SecuredServiceTest, PlaintextBeyondThisMachineNeedsConsent) {
  ServiceOptions options;
  options.listen = "0.0.0.0:0";
  const auto refused = Service::Start(options);
  EXPECT_TRUE(absl::IsInvalidArgument(refused.status()));
  EXPECT_THAT(std::string(refused.status().message()), HasSubstr("--tls-cert"));
}

}  // namespace
}  // namespace tessera
