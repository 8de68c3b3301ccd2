// What clients ask of jobs, made durable before it is acknowledged; no RPC.
#pragma once

#include <functional>
#include <memory>
#include <mutex>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/coordinator_host.h"
#include "server/store/asset_store.h"
#include "tessera/v1/job.pb.h"

namespace tessera {

// Makes what clients ask for durable before it is acknowledged.
struct JobKeeper {
  std::function<absl::Status(JobId)> save;
  std::function<absl::Status(JobId)> remove;
};

// Threads: all methods from any thread.
class JobRequests {
 public:
  // All references must outlive this.
  JobRequests(CoordinatorHost& host, AssetStore& assets, SettingsDefaults defaults,
              JobKeeper keeper);

  // Whether a job may have such settings. Errors: as CompleteSettings.
  absl::Status CheckSettings(const v1::JobSettings& settings) const;
  // owner: the name of the token that asks; empty where none is needed.
  // Errors: as JobService.CreateJob.
  absl::Status Create(const v1::CreateJobRequest& request, const std::string& owner,
                      v1::Job* response);
  // Errors: INVALID_ARGUMENT, NOT_FOUND.
  absl::Status Get(const std::string& name, v1::Job* response) const;
  // response: the job as it is then; may be null. Errors: INVALID_ARGUMENT, NOT_FOUND,
  // FAILED_PRECONDITION; UNAVAILABLE if the job has changed but the change is not durable yet.
  absl::Status Command(JobCommand command, const std::string& name, const std::string& request_id,
                       v1::Job* response);
  // Errors: as Command's.
  absl::Status Look(const v1::LookJobRequest& request, v1::Job* response);

 private:
  absl::Status Keep(JobId job, const std::function<absl::Status(JobId)>& write);
  absl::StatusOr<std::shared_ptr<Film>> ReadFilm(const std::string& sha256,
                                                 const v1::JobSettings& settings);

  CoordinatorHost& host_;
  AssetStore& assets_;
  const SettingsDefaults defaults_;
  const JobKeeper keeper_;
  // Held from before a film is read until its job has it: the room for films is counted for jobs.
  std::mutex film_mu_;
};

}  // namespace tessera
