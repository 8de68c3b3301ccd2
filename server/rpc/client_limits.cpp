#include "server/rpc/client_limits.h"

#include <algorithm>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"

namespace tessera {
namespace {

absl::Status Beyond(const std::string& client, const std::string& what, const char* flag,
                    const char* remedy) {
  return absl::ResourceExhaustedError(
      absl::StrCat(client, ": ", what, " (tessera-server --", flag, "): ", remedy));
}

}  // namespace

std::string ClientOf(const Caller& caller, const std::string& peer) {
  if (!caller.name.empty()) return absl::StrCat("token ", caller.name);
  const size_t port = peer.rfind(':');
  const size_t scheme = peer.find(':');
  // "ipv4:1.2.3.4:5678", "ipv6:[::1]:5678"; others ("unix:", in-process) have no port.
  return absl::StrCat("address ", port == scheme ? peer : peer.substr(0, port));
}

ClientLimits::Use ClientLimits::UseOf(const v1::JobSettings& settings) {
  Use use{.jobs = 1};
  const double frame = 1.0 * settings.width() * settings.height();
  use.pixels = settings.has_region()
                   ? 1.0 * settings.region().width() * settings.region().height()
                   : frame;
  use.samples = use.pixels * static_cast<double>(settings.spp());
  for (const v1::AssetRef& asset : settings.assets()) {
    use.asset_bytes += static_cast<double>(asset.size_bytes());
  }
  return use;
}

absl::Status ClientLimits::CheckRoom(const std::string& client, const Use& used,
                                     const Use& more) const {
  const auto exceeds = [](double used_now, double more_now, int64_t max) {
    return max > 0 && used_now + more_now > static_cast<double>(max);
  };
  if (exceeds(used.jobs, more.jobs, options_.jobs)) {
    return Beyond(client, absl::StrCat("has ", options_.jobs, " jobs that have not ended, as many "
                                       "as one client may have"),
                  "client-jobs", "wait for some, or cancel some");
  }
  if (exceeds(used.pixels, more.pixels, options_.pixels)) {
    return Beyond(client, absl::StrCat("this job has ", more.pixels, " pixels, its others that "
                                       "have not ended ", used.pixels, ", one client may have ",
                                       options_.pixels, " at once"),
                  "client-pixels", "wait for some jobs, or render a smaller frame or --region");
  }
  if (exceeds(used.samples, more.samples, options_.samples)) {
    return Beyond(client, absl::StrCat("this job has ", more.samples, " samples, its others that "
                                       "have not ended ", used.samples, ", one client may have ",
                                       options_.samples, " at once"),
                  "client-samples", "wait for some jobs, or ask for fewer samples (--spp)");
  }
  if (exceeds(used.asset_bytes, more.asset_bytes, options_.asset_bytes)) {
    return Beyond(client, absl::StrCat("the files of this job's scene have ", more.asset_bytes,
                                       " bytes, those of its others that have not ended ",
                                       used.asset_bytes, ", one client may have ",
                                       options_.asset_bytes, " at once"),
                  "client-asset-bytes", "wait for some jobs, or make the scene smaller");
  }
  return absl::OkStatus();
}

void ClientLimits::Forget(const std::string& client) {
  std::vector<JobId> ids;
  {
    std::lock_guard lock(mu_);
    if (const auto jobs = jobs_.find(client); jobs != jobs_.end()) {
      for (const auto& [id, use] : jobs->second) ids.push_back(id);
    }
  }
  std::erase_if(ids, [this](JobId id) { return is_open_(id); });
  std::lock_guard lock(mu_);
  const auto jobs = jobs_.find(client);
  if (jobs == jobs_.end()) return;
  for (const JobId id : ids) jobs->second.erase(id);
  if (jobs->second.empty()) jobs_.erase(jobs);
}

absl::StatusOr<ClientLimits::Hold> ClientLimits::Admit(const std::string& client,
                                                       const v1::JobSettings& settings) {
  Forget(client);
  const Use more = UseOf(settings);
  std::lock_guard lock(mu_);
  Use used;
  const auto add = [&used](const auto& uses) {
    for (const auto& [id, use] : uses) {
      used.jobs += use.jobs;
      used.pixels += use.pixels;
      used.samples += use.samples;
      used.asset_bytes += use.asset_bytes;
    }
  };
  if (const auto jobs = jobs_.find(client); jobs != jobs_.end()) add(jobs->second);
  if (const auto jobs = admitted_.find(client); jobs != admitted_.end()) add(jobs->second);
  if (absl::Status status = CheckRoom(client, used, more); !status.ok()) return status;
  const int64_t admission = next_admission_++;
  admitted_[client][admission] = more;
  return Hold(nullptr, [this, client, admission](void*) {
    std::lock_guard release_lock(mu_);
    const auto admitted = admitted_.find(client);
    admitted->second.erase(admission);
    if (admitted->second.empty()) admitted_.erase(admitted);
  });
}

void ClientLimits::Created(const std::string& client, JobId job, const v1::JobSettings& settings) {
  std::lock_guard lock(mu_);
  jobs_[client][job] = UseOf(settings);
}

absl::StatusOr<ClientLimits::Hold> ClientLimits::OpenStream(const std::string& client) {
  std::lock_guard lock(mu_);
  int64_t& streams = streams_[client];
  if (options_.streams > 0 && streams >= options_.streams) {
    return Beyond(client, absl::StrCat("has ", streams, " streams open, as many as one client may "
                                       "have"),
                  "client-streams", "end some watches, or try again when some have ended");
  }
  ++streams;
  return Hold(nullptr, [this, client](void*) {
    std::lock_guard release_lock(mu_);
    const auto open = streams_.find(client);
    if (--open->second == 0) streams_.erase(open);
  });
}

absl::Status ClientLimits::CheckUpload(const std::string& client, int64_t size_bytes) const {
  if (options_.asset_bytes == 0 || size_bytes <= options_.asset_bytes) return absl::OkStatus();
  return Beyond(client, absl::StrCat("the file has ", size_bytes, " bytes, one client may have ",
                                     options_.asset_bytes, " of files"),
                "client-asset-bytes", "make it smaller");
}

}  // namespace tessera
