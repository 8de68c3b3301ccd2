// tessera.v1.JobService over a coordinator.
#pragma once

#include "server/coordinator_host.h"
#include "server/job_requests.h"
#include "server/rpc/client_limits.h"
#include "server/rpc/watch_hub.h"
#include "server/rpc/write_deadlines.h"
#include "server/security/access.h"
#include "tessera/v1/job.grpc.pb.h"

namespace tessera {

class JobService final : public v1::JobService::CallbackService {
 public:
  // All references must outlive the service.
  JobService(CoordinatorHost& host, AssetStore& assets, WatchHub& watchers,
             SettingsDefaults defaults, JobKeeper keeper, const Access& access,
             ClientLimits& limits, WriteDeadlines& deadlines);

  grpc::ServerUnaryReactor* CreateJob(grpc::CallbackServerContext* context,
                                      const v1::CreateJobRequest* request,
                                      v1::Job* response) override;
  grpc::ServerUnaryReactor* GetJob(grpc::CallbackServerContext* context,
                                   const v1::GetJobRequest* request, v1::Job* response) override;
  grpc::ServerUnaryReactor* ListJobs(grpc::CallbackServerContext* context,
                                     const v1::ListJobsRequest* request,
                                     v1::ListJobsResponse* response) override;
  grpc::ServerWriteReactor<v1::Job>* WatchJob(grpc::CallbackServerContext* context,
                                              const v1::WatchJobRequest* request) override;
  grpc::ServerUnaryReactor* PauseJob(grpc::CallbackServerContext* context,
                                     const v1::PauseJobRequest* request,
                                     v1::Job* response) override;
  grpc::ServerUnaryReactor* ResumeJob(grpc::CallbackServerContext* context,
                                      const v1::ResumeJobRequest* request,
                                      v1::Job* response) override;
  grpc::ServerUnaryReactor* CancelJob(grpc::CallbackServerContext* context,
                                      const v1::CancelJobRequest* request,
                                      v1::Job* response) override;
  grpc::ServerUnaryReactor* LookJob(grpc::CallbackServerContext* context,
                                    const v1::LookJobRequest* request,
                                    v1::Job* response) override;
  grpc::ServerUnaryReactor* DeleteJob(grpc::CallbackServerContext* context,
                                      const v1::DeleteJobRequest* request,
                                      v1::DeleteJobResponse* response) override;

 private:
  absl::Status Create(const grpc::CallbackServerContext& context,
                      const v1::CreateJobRequest& request, v1::Job* response);
  // OK, or why whoever calls may not change the job.
  absl::Status CheckSteering(const grpc::CallbackServerContext& context,
                             const std::string& name) const;
  // Pause, resume, cancel or delete, by whoever calls.
  absl::Status Command(const grpc::CallbackServerContext& context, JobCommand command,
                       const std::string& name, const std::string& request_id, v1::Job* response);

  CoordinatorHost& host_;
  WatchHub& watchers_;
  JobRequests requests_;
  const Access& access_;
  ClientLimits& limits_;
  WriteDeadlines& deadlines_;
};

}  // namespace tessera
