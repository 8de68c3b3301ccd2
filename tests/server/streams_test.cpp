// Streams that do not end well: too many, or to peers that do not read.
#include <atomic>
#include <future>
#include <thread>

#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include "core/base/version.h"
#include "server/coordinator_host.h"
#include "server/rpc/stream_budget.h"
#include "server/rpc/watch_hub.h"
#include "server/rpc/worker_sessions.h"
#include "tessera/v1/job.grpc.pb.h"
#include "tessera/v1/worker.grpc.pb.h"

namespace tessera {
namespace {

TEST(StreamBudget, BoundsStreamsAndBytes) {
  StreamBudget budget("pictures", 2, 100);
  auto first = std::make_unique<StreamBudget::Share>();
  StreamBudget::Share second, third;
  ASSERT_TRUE(budget.Begin(first.get()).ok());
  EXPECT_TRUE(budget.Take(1000, first.get()).ok()) << "a large one alone";
  ASSERT_TRUE(budget.Begin(&second).ok());
  EXPECT_TRUE(absl::IsResourceExhausted(budget.Take(1, &second)));
  const absl::Status refused = budget.Begin(&third);
  EXPECT_TRUE(absl::IsResourceExhausted(refused));
  EXPECT_NE(refused.message().find("try again"), absl::string_view::npos);
  first.reset();
  EXPECT_TRUE(budget.Take(100, &second).ok());
  EXPECT_TRUE(budget.Begin(&third).ok());
}

class WatchOnly final : public v1::JobService::CallbackService {
 public:
  grpc::ServerWriteReactor<v1::Job>* WatchJob(grpc::CallbackServerContext*,
                                              const v1::WatchJobRequest* request) override {
    return hub.Watch(1, *request);
  }
  WatchHub hub{{.get_job =
                    [](JobId, v1::Job* job) {
                      job->mutable_revision()->set_counter(1);
                      return true;
                    },
                .added = [](JobId, const auto&) {},
                .removed = [](JobId, const auto&) {}},
               2};
};

TEST(WatchHub, RefusesMoreWatchesThanItHolds) {
  WatchOnly service;
  grpc::ServerBuilder builder;
  builder.RegisterService(&service);
  const auto server = builder.BuildAndStart();
  const auto stub = v1::JobService::NewStub(server->InProcessChannel({}));
  std::jthread pump([&](const std::stop_token& stop) {
    for (; !stop.stop_requested(); std::this_thread::yield()) service.hub.Pump();
  });
  grpc::ClientContext contexts[3];
  std::unique_ptr<grpc::ClientReader<v1::Job>> readers[3];
  for (int i = 0; i < 3; ++i) {
    readers[i] = stub->WatchJob(&contexts[i], {});
    if (i < 2) readers[i]->WaitForInitialMetadata();
  }
  v1::Job job;
  EXPECT_FALSE(readers[2]->Read(&job));
  const grpc::Status refused = readers[2]->Finish();
  EXPECT_EQ(refused.error_code(), grpc::RESOURCE_EXHAUSTED);
  EXPECT_NE(refused.error_message().find("GetJob"), std::string::npos);
  for (int i = 0; i < 2; ++i) contexts[i].TryCancel();
  server->Shutdown(std::chrono::system_clock::now());
}

class WorkOnly final
    : public v1::WorkerService::WithRawCallbackMethod_Work<v1::WorkerService::Service> {
 public:
  explicit WorkOnly(WorkerSessions& sessions) : sessions_(sessions) {}
  WorkerSessions::Stream* Work(grpc::CallbackServerContext* context) override {
    return sessions_.Accept(context);
  }

 private:
  WorkerSessions& sessions_;
};

TEST(WorkerSessions, AnEndedStreamGoesThoughItsWorkerDoesNotRead) {
  std::promise<SessionId> connected;
  std::promise<void> gone;
  std::atomic<int> heartbeats = 0;
  WorkerSessions sessions([&](const Event& event) {
    if (const auto* e = std::get_if<WorkerConnectedEvent>(&event)) connected.set_value(e->session);
    if (std::holds_alternative<HeartbeatEvent>(event)) ++heartbeats;
    if (std::holds_alternative<WorkerGoneEvent>(event)) gone.set_value();
  });
  WorkOnly service(sessions);
  grpc::ServerBuilder builder;
  builder.RegisterService(&service);
  const auto server = builder.BuildAndStart();
  const auto stub = v1::WorkerService::NewStub(server->InProcessChannel({}));
  grpc::ClientContext context;
  const auto stream = stub->Work(&context);
  v1::WorkerMessage message;
  message.mutable_hello()->set_host("deaf");
  ASSERT_TRUE(stream->Write(message));
  const SessionId session = connected.get_future().get();
  // Nobody reads these: the first stays under way.
  v1::CoordinatorMessage down;
  down.mutable_forget()->set_job(std::string(1 << 20, 'x'));
  for (int i = 0; i < 3; ++i) sessions.Send(session, down);
  sessions.End(session, absl::InvalidArgumentError("a reason"));
  message.mutable_heartbeat()->add_leases()->set_id(1);
  // It may be that nobody takes it, and it waits until the stream is cancelled.
  const auto late = std::async(std::launch::async, [&] { stream->Write(message); });
  sessions.Pump(Now().monotonic_ms + 60000);
  gone.get_future().wait();
  late.wait();
  EXPECT_EQ(heartbeats, 0) << "what comes after the end counts no more";
  context.TryCancel();
  server->Shutdown(std::chrono::system_clock::now());
}

}  // namespace
}  // namespace tessera
