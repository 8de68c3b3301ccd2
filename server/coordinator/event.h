// Everything that can happen to a coordinator.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "core/base/sha256.h"
#include "core/denoise/denoiser.h"
#include "core/film/film.h"
#include "core/film/tile_statistics.h"
#include "server/coordinator/sample_plan.h"
#include "server/coordinator/tile_cost.h"
#include "tessera/v1/job.pb.h"
#include "tessera/v1/trust.pb.h"
#include "tessera/v1/worker.pb.h"

namespace tessera {

using JobId = uint64_t;
using SessionId = uint64_t;  // of one worker's stream; never reused
using LeaseId = uint64_t;

// A moment, handed in.
struct Instant {
  int64_t monotonic_ms = 0;
  int64_t unix_ms = 0;
};

// Clients.
struct CreateJobEvent {
  v1::JobSettings settings;
  std::string request_id{};
  std::string owner{};           // whose token created it; empty where no tokens are asked for
  std::shared_ptr<Film> film{};  // samples to start from; null = none. The job becomes its owner.
};
// kUndoCreate: as if the job had never been asked for; its request_id is free again.
enum class JobCommand { kPause, kResume, kCancel, kDelete, kUndoCreate };
struct JobCommandEvent {
  JobCommand command;
  JobId job = 0;
  std::string request_id;
};

// What is rendered first from now on.
struct LookEvent {
  JobId job = 0;
  std::string request_id{};
  std::optional<v1::Region> region{};  // of the frame; nullopt: nowhere in particular
};

// Start of the server: a job that the catalogue remembers. film: its checkpoint, null = none.
struct RestoreJobEvent {
  v1::Job job;
  std::string request_id;
  std::shared_ptr<Film> film{};    // not needed for a job that has ended
  std::vector<TileCost> costs{};   // of the film, by tile; empty = unknown
  v1::Suspects suspects{};            // as Coordinator::SuspectsOf gave them
  v1::Contributions contributions{};  // to the film, as Coordinator::ContributionsOf gave them
  std::string failure{};           // why a job that has not ended cannot go on; empty = it can
};
// Start of the server: a host that an earlier run has banned.
struct RestoreBanEvent {
  std::string host;
};
// The disk has no room for what is to be kept, or has room again.
struct DiskEvent {
  std::string full{};  // why; empty = there is room
};
// The job's record was written to disk, or could not be and is tried again.
struct RecordStoredEvent {
  JobId job = 0;
  bool has_ended = false;  // what is stored says that the job has
  std::string failure{};   // why it could not be written; empty = it was
};
// The film was written to disk.
struct FilmStoredEvent {
  JobId job = 0;
  bool is_final = false;  // the job had all its samples when that began: what is stored is its end
};

// Workers.
struct WorkerConnectedEvent {
  SessionId session = 0;
  v1::Hello hello;
};
struct WorkerGoneEvent {
  SessionId session = 0;
};
// delta.payload has been decoded into `tile`.
struct DeltaEvent {
  SessionId session = 0;
  v1::TileDelta delta{};
  int64_t wire_bytes = 0;
  TileStatistics tile{};
  std::optional<Sha256Digest> digest{};  // TestimonyOf(tile), if somebody has taken it already
  double noise = 0;  // NoiseOf(tile); 0 = unknown
};
struct HeartbeatEvent {
  SessionId session = 0;
  std::vector<v1::LeaseProgress> leases{};
};
struct DeclineEvent {
  SessionId session = 0;
  v1::DeclineLease decline;
};
struct SceneReadyEvent {
  SessionId session = 0;
  v1::SceneReady ready;
};
struct SceneFailureEvent {
  SessionId session = 0;
  v1::SceneFailure failure;
};
struct DrainEvent {
  SessionId session = 0;
};

// Answers to effects.
// The served picture, filtered from everything that had been merged when it began.
struct PictureEvent {
  JobId job = 0;
  int64_t samples = 0;         // of the film when the filtering began
  double estimated_error = 0;  // sqrt(relMSE); 0 = unknown
  double error_bound = 0;      // ErrorBound of the picture at the job's quality; 0 = unknown
  double filter_core_seconds = 0;  // spent since the last such event
  double filter_seconds = 0;       // since the filtering began
  bool is_refined = false;         // the picture is at the job's quality
  // Of a job that decides by its picture, at its quality: by cell of kCellSizePx. Else empty.
  std::vector<CellError> cell_errors{};
};
// A window of a picture that a worker may filter. Answered by a FilterAnswerEffect, now or later.
struct FilterOfferEvent {
  uint64_t ticket = 0;      // names it; never reused
  v1::FilterLease lease{};  // all but its id
};
// The window is not wanted any more; no answer follows. is_late: the worker has had it for so long
// that the server filters it itself.
struct FilterWithdrawEvent {
  uint64_t ticket = 0;
  bool is_late = false;
};
// filtered.payload has been decoded into `planes`.
struct FilteredEvent {
  SessionId session = 0;
  v1::FilteredWindow filtered{};
  int64_t wire_bytes = 0;
  std::shared_ptr<const FilteredPlanes> planes{};
};
// The server has filtered a window again, and the host had returned other bits.
struct FilterLieEvent {
  std::string host;
};
struct JobFinishedEvent {
  JobId job = 0;
  Sha256Digest digest{};
};

struct TickEvent {
  double ingest_load = 0;  // share of the time since the last one in which deltas were taken in
};

using Event =
    std::variant<CreateJobEvent, JobCommandEvent, LookEvent, RestoreJobEvent, RestoreBanEvent,
                 DiskEvent, RecordStoredEvent, FilmStoredEvent, WorkerConnectedEvent,
                 WorkerGoneEvent, DeltaEvent, HeartbeatEvent, DeclineEvent,
                 SceneReadyEvent, SceneFailureEvent, DrainEvent, PictureEvent, FilterOfferEvent,
                 FilterWithdrawEvent, FilteredEvent, FilterLieEvent, JobFinishedEvent, TickEvent>;

}  // namespace tessera
