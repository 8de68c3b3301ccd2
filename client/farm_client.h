// The client library: everything that one can ask of a coordinator, be it a server on the network
// or the one inside this process. What the command line itself uses.
//
// Each call repeats itself while the server is unreachable, with back-off and a limit; calls that
// change something carry a request_id, so that a repetition has no second effect. Errors are one
// line with cause and remedy: UNAVAILABLE (no server), CANCELLED (the stop token), else as the
// server answered. Threads: all methods from any thread.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include <grpcpp/channel.h>

#include "absl/status/statusor.h"
#include "client/asset_collection.h"
#include "client/rpc_caller.h"
#include "core/film/tile_statistics.h"
#include "core/image/image.h"
#include "tessera/v1/asset.grpc.pb.h"
#include "tessera/v1/image.grpc.pb.h"
#include "tessera/v1/job.grpc.pb.h"
#include "tessera/v1/worker.grpc.pb.h"

namespace tessera {

struct FarmClientOptions {
  std::string address;  // for errors; empty = the coordinator inside this process
  bool tls = false;     // whether the channel speaks TLS, for errors too
  std::string token;    // bearer token; empty = none
  RetryOptions retry;
};

struct UploadReport {
  int64_t files_sent = 0;
  int64_t bytes_sent = 0;  // repeated pieces included
};

struct ImageRequest {
  PixelRect region;                 // frame coordinates; empty: all that the job renders
  std::vector<std::string> layers;  // as ImageService names them; empty: final
  bool wait_for_filter = false;     // rather than the newest filtered tiles
};

struct FetchedImage {
  Image image;     // channels of all layers, in order; no metadata
  double spp = 0;  // mean over pixels when it was taken
};

// Bytes that the server has so far, and bytes in all.
using UploadProgress = std::function<void(int64_t bytes_done, int64_t bytes_total)>;

inline constexpr std::chrono::milliseconds kWatchInterval{200};

class FarmClient {
 public:
  FarmClient(std::shared_ptr<grpc::Channel> channel, const FarmClientOptions& options);

  // Sends what the server lacks, resuming half-sent files. `progress` may be null.
  // Errors: DATA_LOSS a file changed while it was being sent.
  absl::StatusOr<UploadReport> Upload(const std::vector<AssetFile>& files,
                                      const UploadProgress& progress = nullptr,
                                      std::stop_token stop = {});

  // `continue_film_sha256`: the digest of an uploaded film; empty = from the first sample.
  absl::StatusOr<v1::Job> CreateJob(const v1::JobSettings& settings,
                                    const std::string& continue_film_sha256 = {});
  absl::StatusOr<v1::Job> GetJob(const std::string& name);
  // All jobs, page by page.
  absl::StatusOr<std::vector<v1::Job>> ListJobs();
  // What is rendered first from now on; nullopt: nothing in particular.
  absl::StatusOr<v1::Job> LookJob(const std::string& name, const std::optional<v1::Region>& region);
  absl::StatusOr<v1::Job> PauseJob(const std::string& name);
  absl::StatusOr<v1::Job> ResumeJob(const std::string& name);
  absl::StatusOr<v1::Job> CancelJob(const std::string& name);
  absl::Status DeleteJob(const std::string& name);
  absl::StatusOr<std::vector<v1::Worker>> ListWorkers();

  // Calls `on_change` for each revision that arrives (some are skipped) until the job is in a
  // terminal state, and returns that. A broken stream is taken up where it ended.
  // looks_at: the part of the picture whose previews the server shall keep up to date for this
  // watcher, in frame coordinates; nullopt: all; without pixels: none.
  absl::StatusOr<v1::Job> Watch(const std::string& name,
                                const std::function<void(const v1::Job&)>& on_change,
                                std::chrono::milliseconds min_interval = kWatchInterval,
                                std::stop_token stop = {},
                                const std::optional<v1::Region>& looks_at = std::nullopt);

  // The layers as they are now.
  // Errors: INTERNAL what arrives is not what its header promises.
  absl::StatusOr<FetchedImage> GetImage(const std::string& name, const ImageRequest& request,
                                        std::stop_token stop = {});

  // Every node of every tile of the job.
  // Errors: FAILED_PRECONDITION no sample has been merged yet; INTERNAL a node that is damaged.
  absl::StatusOr<std::vector<TileStatistics>> GetFilm(const std::string& name,
                                                      std::stop_token stop = {});

 private:
  absl::StatusOr<std::vector<v1::MissingAsset>> FindMissing(const std::vector<AssetFile>& files,
                                                            std::stop_token stop);
  absl::Status UploadOne(const AssetFile& file, int64_t offset_bytes,
                         const std::function<void(int64_t)>& on_bytes, UploadReport* report,
                         std::stop_token stop);
  std::string NewRequestId();

  RpcCaller caller_;
  std::unique_ptr<v1::AssetService::StubInterface> assets_;
  std::unique_ptr<v1::JobService::StubInterface> jobs_;
  std::unique_ptr<v1::ImageService::StubInterface> images_;
  std::unique_ptr<v1::WorkerService::StubInterface> workers_;
};

// Whether a job will not change any more.
bool IsTerminal(v1::JobState state);

// "jobs/7" for "7" and "jobs/7". Errors: INVALID_ARGUMENT for anything else.
absl::StatusOr<std::string> JobName(const std::string& text);

}  // namespace tessera
