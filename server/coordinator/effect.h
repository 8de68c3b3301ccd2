// Everything that a coordinator asks its adapters to do.
#pragma once

#include <cstdint>
#include <string>
#include <variant>
#include <vector>

#include "absl/status/status.h"
#include "server/coordinator/event.h"
#include "server/coordinator/tile_queue.h"

namespace tessera {

// Messages to one session keep their order.
struct SendEffect {
  SessionId session = 0;
  v1::CoordinatorMessage message;
};
struct CloseSessionEffect {
  SessionId session = 0;
  absl::Status status;  // what the worker is told
};
// The job's revision has moved: watchers want to know.
struct JobChangedEffect {
  JobId job = 0;
};
// Samples of the tile have been committed.
struct TileChangedEffect {
  JobId job = 0;
  int64_t tile = 0;
};
// The job's record must survive a restart. with_film: so must its film.
struct SaveJobEffect {
  JobId job = 0;
  bool with_film = false;
};
// The host's ban must survive a restart.
struct BanEffect {
  std::string host;
  std::string reason;
};
struct RemoveJobEffect {
  JobId job = 0;
};
// Filter the picture as it is now and answer with PictureEvent; no sample is merged before that.
struct EvaluatePictureEffect {
  JobId job = 0;
};
// Answers a FilterOfferEvent.
struct FilterAnswerEffect {
  uint64_t ticket = 0;
  std::shared_ptr<const FilteredPlanes> planes{};  // null: no worker filters it
  std::string host{};                              // whose they are
};
// Filter the last picture, take the film's digest, and answer with JobFinishedEvent. The film does
// not change any more.
struct FinishJobEffect {
  JobId job = 0;
};

// For the log alone. worker, other: N of "workers/N".
// The lease has made no progress for its time; its unit is for others.
struct LeaseExpiredEffect {
  SessionId session = 0;
  uint64_t worker = 0;
  JobId job = 0;
  LeaseId lease = 0;
  Unit unit;
};
// What another worker's lease `slow` has had for long was given to this one as well.
struct RaceBegunEffect {
  SessionId session = 0;
  uint64_t worker = 0;
  JobId job = 0;
  LeaseId lease = 0;
  Unit unit;
  LeaseId slow = 0;
  uint64_t other = 0;  // who has that
};
// Two hosts have rendered an audited unit to different bits; a third one decides who is right.
struct AuditDiffersEffect {
  JobId job = 0;
  Unit unit;
  std::string host;   // whose delta has just come
  std::string other;  // whose came before
};

using Effect = std::variant<SendEffect, CloseSessionEffect, JobChangedEffect, TileChangedEffect,
                            SaveJobEffect, BanEffect, RemoveJobEffect, EvaluatePictureEffect,
                            FinishJobEffect, FilterAnswerEffect, LeaseExpiredEffect,
                            RaceBegunEffect, AuditDiffersEffect>;

// What one step led to.
struct StepResult {
  absl::Status status;  // for the caller of the event
  JobId job = 0;        // CreateJobEvent: the job that it named
  bool is_new = false;  // CreateJobEvent: whether it made that job, or repeats a request
  std::vector<Effect> effects;
};

}  // namespace tessera
