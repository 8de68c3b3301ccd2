#include "client/cli/scene_submission.h"

#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/cli/film_settings.h"
#include "client/cli/job_settings.h"

namespace tessera {
namespace {

// A server that was asked for room may have dropped an asset between the upload and the job.
constexpr int kSubmitAttempts = 3;

absl::StatusOr<v1::JobSettings> ReadSettings(const std::string& film_path) {
  const absl::StatusOr<FilmFile> film = ReadFilmFile(film_path);
  if (!film.ok()) return film.status();
  return SettingsOfFilm(*film, film_path);
}

}  // namespace

absl::StatusOr<SceneSubmission> PrepareSubmission(const SceneFlags& flags) {
  std::optional<v1::JobSettings> film;
  if (!flags.continue_film.empty()) {
    absl::StatusOr<v1::JobSettings> read = ReadSettings(flags.continue_film);
    if (!read.ok()) {
      return absl::Status(read.status().code(),
                          absl::StrCat("--continue: ", read.status().message()));
    }
    film = *std::move(read);
    if (!film->environment().map_name().empty() && flags.env.empty() && flags.sky.empty()) {
      return absl::InvalidArgumentError(
          absl::StrCat("--continue: the film was lit by the environment map ",
                       film->environment().map_name(), ": name the file with --env"));
    }
  }
  absl::StatusOr<v1::JobSettings> settings =
      SettingsFromFlags(flags, film.has_value() ? &*film : nullptr);
  if (!settings.ok()) return settings.status();
  absl::StatusOr<SceneAssets> assets = CollectAssets(flags.scene, flags.env);
  if (!assets.ok()) return assets.status();
  SceneSubmission submission;
  SetAssets(*assets, &*settings);
  submission.settings = *std::move(settings);
  submission.files = std::move(assets->files);
  if (film.has_value()) {
    const absl::Status continues = CheckContinues(*film, submission.settings);
    if (!continues.ok()) return continues;
    absl::StatusOr<AssetFile> file = HashFile(flags.continue_film, flags.continue_film);
    if (!file.ok()) return file.status();
    submission.continue_film_sha256 = ToBytes(file->sha256);
    submission.files.push_back(*std::move(file));
  }
  return submission;
}

absl::StatusOr<v1::Job> Submit(FarmClient& client, const SceneSubmission& submission,
                               ProgressBar* progress, std::stop_token stop) {
  for (int attempt = 1;; ++attempt) {
    const absl::StatusOr<UploadReport> uploaded = client.Upload(
        submission.files,
        [progress](int64_t done, int64_t total) { progress->ShowUpload(done, total); }, stop);
    if (!uploaded.ok()) return uploaded.status();
    absl::StatusOr<v1::Job> job =
        client.CreateJob(submission.settings, submission.continue_film_sha256);
    if (job.ok() || !absl::IsFailedPrecondition(job.status()) || attempt == kSubmitAttempts) {
      return job;
    }
  }
}

}  // namespace tessera
