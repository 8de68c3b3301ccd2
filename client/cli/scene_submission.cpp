#include "client/cli/scene_submission.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/cli/film_settings.h"
#include "client/cli/flag_names.h"
#include "client/cli/job_settings.h"
#include "client/cli/replay.h"

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

// What the flags begin from: a film or a picture to replay.
absl::Status CheckStart(const SceneFlags& flags, const std::string& flag,
                        const v1::JobSettings& film) {
  const std::string& map_name = film.environment().map_name();
  if (map_name.empty() || !flags.env.empty() || !flags.sky.empty()) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(
      flag, ": the film was lit by the environment map ", map_name, ": name the file with --env"));
}

absl::StatusOr<SceneSubmission> CollectFiles(const SceneFlags& flags, v1::JobSettings settings) {
  absl::StatusOr<SceneAssets> assets = CollectAssets(flags.scene, flags.env);
  if (!assets.ok()) return assets.status();
  SceneSubmission submission;
  SetAssets(*assets, &settings);
  submission.settings = std::move(settings);
  submission.files = std::move(assets->files);
  return submission;
}

absl::StatusOr<SceneSubmission> PrepareContinued(const SceneFlags& flags) {
  const absl::StatusOr<FilmToContinue> film = ReadFilm(flags.continue_film);
  if (!film.ok()) return film.status();
  absl::Status status = CheckStart(flags, "--continue", film->settings);
  if (!status.ok()) return status;
  const absl::StatusOr<v1::JobSettings> settings = SettingsFromFlags(flags, &film->settings);
  if (!settings.ok()) return settings.status();
  if (settings->spp() < film->samples_end) {
    return absl::InvalidArgumentError(
        absl::StrCat("--spp ", settings->spp(), ": the film has up to ", film->samples_end,
                     " samples per pixel already; ask for at least as many"));
  }
  absl::StatusOr<SceneSubmission> submission = CollectFiles(flags, *settings);
  if (!submission.ok()) return submission;
  status = CheckContinues("--continue", film->settings, submission->settings);
  if (!status.ok()) return status;
  absl::StatusOr<AssetFile> file = HashFile(flags.continue_film, flags.continue_film);
  if (!file.ok()) return file.status();
  submission->continue_film_sha256 = ToBytes(file->sha256);
  submission->files.push_back(*std::move(file));
  return submission;
}

absl::StatusOr<SceneSubmission> PrepareReplay(const SceneFlags& flags) {
  for (const auto& [flag, value] :
       {std::pair{"--spp", &flags.spp}, std::pair{"--target-error", &flags.target_error},
        std::pair{"--target-tile-error", &flags.target_tile_error},
        std::pair{"--max-time", &flags.max_time}, std::pair{"--continue", &flags.continue_film}}) {
    if (value->empty()) continue;
    return absl::InvalidArgumentError(absl::StrCat(
        flag, ": a replay has the samples of its picture, no more and no less: drop it"));
  }
  const absl::StatusOr<ReplayedPicture> picture = ReadReplayedPicture(flags.replay);
  if (!picture.ok()) return picture.status();
  absl::Status status = CheckStart(flags, "--replay", picture->settings);
  if (!status.ok()) return status;
  absl::StatusOr<v1::JobSettings> settings = SettingsFromFlags(flags, &picture->settings);
  if (!settings.ok()) return settings.status();
  status = SetReplay(*picture, &*settings);
  if (!status.ok()) return status;
  absl::StatusOr<SceneSubmission> submission = CollectFiles(flags, *settings);
  if (!submission.ok()) return submission;
  v1::JobSettings film = picture->settings;
  submission->replay_arithmetic = film.arithmetic();
  film.set_arithmetic(submission->settings.arithmetic());  // another one is a choice, not a slip
  status = CheckContinues("--replay", film, submission->settings);
  if (!status.ok()) return status;
  submission->replay_digest = picture->digest;
  return submission;
}

}  // namespace

absl::StatusOr<SceneSubmission> PrepareSubmission(const SceneFlags& flags) {
  if (!flags.replay.empty()) return PrepareReplay(flags);
  if (!flags.continue_film.empty()) return PrepareContinued(flags);
  const absl::StatusOr<v1::JobSettings> settings = SettingsFromFlags(flags, nullptr);
  if (!settings.ok()) return settings.status();
  return CollectFiles(flags, *settings);
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
    if (job.ok()) return job;
    if (!absl::IsFailedPrecondition(job.status()) || attempt == kSubmitAttempts) {
      return absl::Status(job.status().code(),
                          WithFlagNames(std::string(job.status().message())));
    }
  }
}

}  // namespace tessera
