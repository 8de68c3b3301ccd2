// tessera.v1.JobService over a coordinator.
#pragma once

#include <functional>

#include "server/coordinator_host.h"
#include "server/rpc/watch_hub.h"
#include "server/store/asset_store.h"
#include "tessera/v1/job.grpc.pb.h"

namespace tessera {

// Makes what clients ask for durable before it is acknowledged.
struct JobKeeper {
  std::function<absl::Status(JobId)> save;
  std::function<absl::Status(JobId)> remove;
};

class JobService final : public v1::JobService::CallbackService {
 public:
  // All references must outlive the service.
  JobService(CoordinatorHost& host, AssetStore& assets, WatchHub& watchers,
             SettingsDefaults defaults, JobKeeper keeper);

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
  grpc::ServerUnaryReactor* DeleteJob(grpc::CallbackServerContext* context,
                                      const v1::DeleteJobRequest* request,
                                      v1::DeleteJobResponse* response) override;

 private:
  absl::Status Create(const v1::CreateJobRequest& request, v1::Job* response);
  absl::StatusOr<std::shared_ptr<Film>> ReadFilm(const std::string& sha256,
                                                 const v1::JobSettings& settings);
  absl::Status Get(const std::string& name, v1::Job* response) const;
  absl::Status Command(JobCommand command, const std::string& name, const std::string& request_id,
                       v1::Job* response);

  CoordinatorHost& host_;
  AssetStore& assets_;
  WatchHub& watchers_;
  const SettingsDefaults defaults_;
  const JobKeeper keeper_;
};

}  // namespace tessera
