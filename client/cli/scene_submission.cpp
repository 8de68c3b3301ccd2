#include "client/cli/scene_submission.h"

#include <algorithm>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/cli/film_settings.h"
#include "client/cli/job_settings.h"

namespace tessera {
namespace {

// A server that was asked for room may have dropped an asset between the upload and the job.
constexpr int kSubmitAttempts = 3;

struct FilmToContinue {
  v1::JobSettings settings;
  int64_t samples_end = 0;  // no pixel has a sample from here on
};

absl::StatusOr<FilmToContinue> ReadFilm(const std::string& path) {
  const absl::StatusOr<FilmFile> file = ReadFilmFile(path);
  if (!file.ok()) {
    return absl::Status(file.status().code(),
                        absl::StrCat("--continue: ", file.status().message()));
  }
  absl::StatusOr<v1::JobSettings> settings = SettingsOfFilm(*file, path);
  if (!settings.ok()) return settings.status();
  FilmToContinue film{*std::move(settings)};
  for (const TileStatistics& node : file->nodes) {
    film.samples_end = std::max(film.samples_end, node.range().end);
  }
  return film;
}

}  // namespace

absl::StatusOr<SceneSubmission> PrepareSubmission(const SceneFlags& flags) {
  std::optional<FilmToContinue> film;
  if (!flags.continue_film.empty()) {
    absl::StatusOr<FilmToContinue> read = ReadFilm(flags.continue_film);
    if (!read.ok()) return read.status();
    film = *std::move(read);
    const std::string& map_name = film->settings.environment().map_name();
    if (!map_name.empty() && flags.env.empty() && flags.sky.empty()) {
      return absl::InvalidArgumentError(
          absl::StrCat("--continue: the film was lit by the environment map ", map_name,
                       ": name the file with --env"));
    }
  }
  absl::StatusOr<v1::JobSettings> settings =
      SettingsFromFlags(flags, film.has_value() ? &film->settings : nullptr);
  if (!settings.ok()) return settings.status();
  if (film.has_value() && settings->spp() < film->samples_end) {
    return absl::InvalidArgumentError(
        absl::StrCat("--spp ", settings->spp(), ": the film has up to ", film->samples_end,
                     " samples per pixel already; ask for at least as many"));
  }
  absl::StatusOr<SceneAssets> assets = CollectAssets(flags.scene, flags.env);
  if (!assets.ok()) return assets.status();
  SceneSubmission submission;
  SetAssets(*assets, &*settings);
  submission.settings = *std::move(settings);
  submission.files = std::move(assets->files);
  if (film.has_value()) {
    const absl::Status continues = CheckContinues(film->settings, submission.settings);
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
