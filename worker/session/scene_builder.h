// Builds one scene at a time on a thread of its own: fetches all files of the job, then lets the
// renderer load them. Fetching comes first: a broken link is never taken for a broken scene.
#pragma once

#include <atomic>
#include <condition_variable>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>

#include "tessera/v1/job.pb.h"
#include "worker/session/asset_fetcher.h"
#include "worker/session/renderer.h"
#include "worker/session/session_machine.h"
#include "worker/session/unit_journal.h"

namespace tessera {

class SceneBuilder {
 public:
  // `renderer` is null unless the outcome is kReady. Called on the builder's thread.
  using Done = std::function<void(const std::string& scene, BuildOutcome outcome,
                                  std::shared_ptr<const Renderer> renderer)>;

  // Borrows `factory`, `fetcher` and `journal`, which may be null. memory_bytes: what one scene may
  // need; 0 = unlimited.
  SceneBuilder(RendererFactory& factory, AssetFetcher& fetcher, int64_t memory_bytes, int threads,
               UnitJournal* journal, Done done);
  // Cancels what can be cancelled (fetching), waits for the rest.
  ~SceneBuilder();

  // The build before this one must be done. job: for the journal.
  void Build(const std::string& scene, const std::string& job, const v1::JobSettings& settings);
  void Cancel();

 private:
  struct Request {
    std::string scene;
    std::string job;
    v1::JobSettings settings;
  };
  void Run();
  BuildOutcome BuildNow(const v1::JobSettings& settings, std::shared_ptr<const Renderer>* renderer);

  RendererFactory& factory_;
  AssetFetcher& fetcher_;
  const int64_t memory_bytes_;
  const int threads_;
  UnitJournal* const journal_;
  const Done done_;
  std::mutex mu_;
  std::condition_variable cv_;
  std::optional<Request> request_;  // guarded by mu_
  bool stopping_ = false;           // guarded by mu_
  std::atomic<bool> cancelled_ = false;
  std::thread thread_;
};

// What a failed build means to the server.
BuildOutcome OutcomeOfBuildError(const absl::Status& error);
// What a failed fetch means to the server.
BuildOutcome OutcomeOfFetchError(const absl::Status& error);

}  // namespace tessera
