#include "worker/session/scene_builder.h"

#include <chrono>
#include <map>
#include <utility>

#include "absl/strings/str_cat.h"
#include "worker/session/job_conversion.h"

namespace tessera {
namespace {

BuildOutcome Failure(BuildOutcome::Kind kind, const absl::Status& error) {
  BuildOutcome outcome;
  outcome.kind = kind;
  outcome.detail = std::string(error.message());
  return outcome;
}

}  // namespace

BuildOutcome OutcomeOfBuildError(const absl::Status& error) {
  switch (error.code()) {
    case absl::StatusCode::kResourceExhausted:
    case absl::StatusCode::kFailedPrecondition:
      return Failure(BuildOutcome::Kind::kMemory, error);
    case absl::StatusCode::kCancelled:
      return Failure(BuildOutcome::Kind::kCancelled, error);
    default:
      return Failure(BuildOutcome::Kind::kScene, error);
  }
}

BuildOutcome OutcomeOfFetchError(const absl::Status& error) {
  return Failure(
      absl::IsCancelled(error) ? BuildOutcome::Kind::kCancelled : BuildOutcome::Kind::kAssets,
      error);
}

SceneBuilder::SceneBuilder(RendererFactory& factory, AssetFetcher& fetcher, int64_t memory_bytes,
                           int threads, UnitJournal* journal, Done done)
    : factory_(factory),
      fetcher_(fetcher),
      memory_bytes_(memory_bytes),
      threads_(threads),
      journal_(journal),
      done_(std::move(done)),
      thread_([this] { Run(); }) {}

SceneBuilder::~SceneBuilder() {
  {
    std::lock_guard lock(mu_);
    stopping_ = true;
  }
  cv_.notify_all();
  Cancel();
  thread_.join();
}

void SceneBuilder::Build(const std::string& scene, const std::string& job,
                         const v1::JobSettings& settings) {
  {
    std::lock_guard lock(mu_);
    cancelled_ = false;
    fetcher_.Resume();
    request_ = Request{scene, job, settings};
  }
  cv_.notify_all();
}

void SceneBuilder::Cancel() {
  std::lock_guard lock(mu_);
  cancelled_ = true;
  fetcher_.Interrupt();
}

void SceneBuilder::Run() {
  while (true) {
    Request request;
    {
      std::unique_lock lock(mu_);
      cv_.wait(lock, [this] { return stopping_ || request_; });
      if (stopping_) return;
      request = *std::move(request_);
      request_.reset();
    }
    std::shared_ptr<const Renderer> renderer;
    if (journal_ != nullptr) journal_->BeginBuild(request.job);
    BuildOutcome outcome = BuildNow(request.settings, &renderer);
    if (journal_ != nullptr) journal_->EndBuild();
    done_(request.scene, std::move(outcome), std::move(renderer));
  }
}

BuildOutcome SceneBuilder::BuildNow(const v1::JobSettings& settings,
                                    std::shared_ptr<const Renderer>* renderer) {
  const auto begin = std::chrono::steady_clock::now();
  const int64_t asset_bytes = AssetBytesOf(settings);
  if (memory_bytes_ > 0 && asset_bytes > memory_bytes_) {
    return Failure(BuildOutcome::Kind::kMemory,
                   absl::ResourceExhaustedError(absl::StrCat("the scene's files have ", asset_bytes,
                                                             " bytes, this worker has room for ",
                                                             memory_bytes_)));
  }
  std::map<std::string, Blob> blobs;
  for (const v1::AssetRef& asset : settings.assets()) {
    absl::StatusOr<Blob> blob = fetcher_.Fetch(asset);
    if (!blob.ok()) return OutcomeOfFetchError(blob.status());
    blobs[asset.name()] = *std::move(blob);
  }
  const AssetReader read_asset = [&blobs](const std::string& name) -> absl::StatusOr<Blob> {
    const auto found = blobs.find(name);
    if (found == blobs.end()) {
      return absl::NotFoundError(absl::StrCat("file '", name, "' was not uploaded with the scene"));
    }
    return found->second;
  };
  absl::StatusOr<std::unique_ptr<Renderer>> built =
      factory_.Build(settings, memory_bytes_, threads_, read_asset);
  if (!built.ok()) return OutcomeOfBuildError(built.status());
  if (cancelled_) return OutcomeOfBuildError(absl::CancelledError("the job is gone"));
  BuildOutcome outcome;
  outcome.report = (*built)->Report();
  outcome.report.set_memory_bytes((*built)->memory_bytes());
  outcome.report.set_load_seconds(
      std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
  *renderer = *std::move(built);
  return outcome;
}

}  // namespace tessera
