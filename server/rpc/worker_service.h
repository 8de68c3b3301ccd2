// tessera.v1.WorkerService over a coordinator.
#pragma once

#include "server/coordinator_host.h"
#include "server/rpc/worker_sessions.h"
#include "tessera/v1/worker.grpc.pb.h"

namespace tessera {

class WorkerService final : public v1::WorkerService::CallbackService {
 public:
  // Both must outlive the service.
  WorkerService(CoordinatorHost& host, WorkerSessions& sessions)
      : host_(host), sessions_(sessions) {}

  grpc::ServerBidiReactor<v1::WorkerMessage, v1::CoordinatorMessage>* Work(
      grpc::CallbackServerContext* context) override {
    return sessions_.Accept(context);
  }
  grpc::ServerUnaryReactor* ListWorkers(grpc::CallbackServerContext* context,
                                        const v1::ListWorkersRequest*,
                                        v1::ListWorkersResponse* response) override {
    for (v1::Worker& worker :
         host_.Read([](const Coordinator& c) { return c.ListWorkers(Now()); })) {
      *response->add_workers() = std::move(worker);
    }
    grpc::ServerUnaryReactor* const reactor = context->DefaultReactor();
    reactor->Finish(grpc::Status::OK);
    return reactor;
  }

 private:
  CoordinatorHost& host_;
  WorkerSessions& sessions_;
};

}  // namespace tessera
