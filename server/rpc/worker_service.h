// tessera.v1.WorkerService over a coordinator.
#pragma once

#include "server/coordinator_host.h"
#include "server/picture/filter_desk.h"
#include "server/rpc/filter_input.h"
#include "server/rpc/refused_stream.h"
#include "server/rpc/worker_sessions.h"
#include "server/security/access.h"
#include "tessera/v1/worker.grpc.pb.h"

namespace tessera {

// The stream of a session hands on bytes (WorkerSessions::Stream), the others messages.
using WorkerServiceBase = v1::WorkerService::WithRawCallbackMethod_Work<
    v1::WorkerService::WithCallbackMethod_ReadFilterInput<
        v1::WorkerService::WithCallbackMethod_ListWorkers<v1::WorkerService::Service>>>;

class WorkerService final : public WorkerServiceBase {
 public:
  // All must outlive the service.
  WorkerService(CoordinatorHost& host, WorkerSessions& sessions, FilterDesk& desk,
                const Access& access)
      : host_(host), sessions_(sessions), desk_(desk), access_(access) {}

  WorkerSessions::Stream* Work(grpc::CallbackServerContext* context) override {
    const absl::Status status = access_.Check(*context, Role::kWorker).status();
    if (status.ok()) return sessions_.Accept(context);
    return new RefusedStream<WorkerSessions::Stream>(status);
  }
  grpc::ServerWriteReactor<v1::ReadFilterInputResponse>* ReadFilterInput(
      grpc::CallbackServerContext* context,
      const v1::ReadFilterInputRequest* request) override {
    absl::Status status = access_.Check(*context, Role::kWorker).status();
    std::shared_ptr<const std::string> input;
    if (status.ok()) {
      const uint64_t ticket = host_.Read([&](const Coordinator& c) {
        return c.FilterTicketOf(request->worker(), request->lease_id());
      });
      input = desk_.InputOf(ticket);
      if (input == nullptr) status = absl::NotFoundError("the lease is gone");
    }
    using Stream = grpc::ServerWriteReactor<v1::ReadFilterInputResponse>;
    if (!status.ok()) return new RefusedStream<Stream>(status);
    return new FilterInputStream(std::move(input));
  }
  grpc::ServerUnaryReactor* ListWorkers(grpc::CallbackServerContext* context,
                                        const v1::ListWorkersRequest*,
                                        v1::ListWorkersResponse* response) override {
    grpc::ServerUnaryReactor* const reactor = context->DefaultReactor();
    if (const absl::Status status = access_.Check(*context, Role::kView).status(); !status.ok()) {
      reactor->Finish(ToGrpc(status));
      return reactor;
    }
    for (v1::Worker& worker :
         host_.Read([](const Coordinator& c) { return c.ListWorkers(Now()); })) {
      *response->add_workers() = std::move(worker);
    }
    reactor->Finish(grpc::Status::OK);
    return reactor;
  }

 private:
  CoordinatorHost& host_;
  WorkerSessions& sessions_;
  FilterDesk& desk_;
  const Access& access_;
};

}  // namespace tessera
