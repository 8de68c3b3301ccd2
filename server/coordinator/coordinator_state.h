// The coordinator's records of one job and one worker; for the coordinator's sources only.
#pragma once

#include <algorithm>
#include <map>
#include <memory>
#include <set>
#include <string>

#include "core/denoise/frame_filter.h"
#include "server/coordinator/coordinator.h"
#include "server/coordinator/limits.h"

namespace tessera {

// What a film and its picture take in memory, about. For each pixel a stored node, one that waits
// for its sibling, the resolved and the filtered planes (152), and what the filter keeps; for each
// tile what keeps account of them.
inline int64_t FilmBytesOf(const TileGrid& grid) {
  return grid.region().area() * (2 * kFilmBytesPerPixel + 152 + kKeptBytesPerPixelMax) +
         grid.num_tiles() * 1024;
}

inline constexpr char kFilmsFull[] =
    "the server's memory for films is full: delete finished jobs, or cancel paused ones";

// The text's first `bytes_max` bytes, less a character that they would cut: a record with half a
// character could not be read back.
inline std::string CutText(const std::string& text, size_t bytes_max) {
  size_t size = std::min(text.size(), bytes_max);
  const auto continues = [&](size_t i) { return (static_cast<unsigned char>(text[i]) >> 6) == 2; };
  while (size > 0 && size < text.size() && continues(size)) --size;
  return text.substr(0, size);
}

inline void AddCost(const TileCost& cost, v1::JobProgress* progress) {
  progress->set_rays(progress->rays() + cost.rays);
  progress->set_delta_bytes(progress->delta_bytes() + cost.delta_bytes);
  progress->set_render_core_seconds(progress->render_core_seconds() +
                                    1e-9 * static_cast<double>(cost.render_ns));
}

inline int64_t MaxTimeMs(const v1::JobSettings& settings) {
  return settings.max_time().seconds() * 1000 + settings.max_time().nanos() / 1000000;
}

// Of a scene of which nothing is known yet.
inline constexpr double kUnknownNsPerSample = 5000;

// What hosts say of a unit that is audited: who, and the SHA-256 of what it rendered.
struct Testimony {
  std::string host;
  Sha256Digest digest;
};
// A unit that was being rendered when workers crashed. It is rendered by a worker that does nothing
// else, until somebody has rendered it or it is known to be to blame.
struct Suspect {
  int crashes_alone = 0;  // with nothing else under way
  bool is_half = false;   // of a unit that was to blame
  std::set<std::string> hosts;                       // that have crashed
  std::set<std::pair<std::string, int>> processes;   // each counts once
};

struct Coordinator::Job {
  JobId id = 0;
  std::string request_id;
  v1::Job record;  // what clients see, but for progress.workers
  TileGrid grid;
  std::shared_ptr<Film> film;
  std::vector<TileCost> costs;  // of the film, by tile; empty before the first delta
  std::unique_ptr<TileQueue> queue;  // null once no sample is wanted any more
  // Sampled adaptively: where the samples of each tile end for now, and how many all have already.
  // Else empty.
  std::vector<int64_t> plan;
  int64_t plan_floor = 0;
  int64_t plan_samples = 0;  // of all pixels, that it asks for

  std::map<SessionId, int> leases_of_session;
  std::map<Unit, std::vector<LeaseId>> leases_of_unit;
  int64_t samples_under_way = 0;
  // Of its share (see GrantFrom), in time of threads: what its leases have taken, or more where it
  // would be too far behind, and about the longest lease lately, of whole tiles.
  double served_ns = 0;
  double lease_ns = 0;
  // What leases have taken, and their samples, in this incarnation.
  double rendered_ns = 0;
  double rendered_samples = 0;
  // Units that are not the queue's to hand out while they are listed here.
  std::map<Unit, std::vector<Testimony>> audits;
  std::set<Unit> audits_waiting;  // those that nobody renders just now
  std::map<Unit, Suspect> suspects;
  // Of earlier runs of the server, whose ranges may have been cut in another way.
  std::map<Unit, Suspect> past_suspects;
  std::set<std::pair<std::string, int>> build_crashes;  // processes that its scene has crashed
  // With audits: what each host has added to the film, until the job closes.
  std::map<std::string, std::vector<Unit>> rendered_by;
  int64_t resets = 0;  // that have taken samples out of the film
  // With auto_depth: what the pilots of hosts have found, in this incarnation.
  std::map<std::string, int> depths_found;
  bool holds_film = false;  // its film counts into film_bytes_
  // The most memory of a worker that declined for want of it: none with as little is asked again.
  int64_t memory_short_bytes = -1;
  int64_t submitted_ms = 0;    // monotonic; 0 = to an earlier incarnation
  int64_t work_ms = 0;  // monotonic moment of the first lease of this incarnation; 0 = none yet
  int64_t spent_ms = 0; // before that, by earlier incarnations and before pauses
  int64_t first_merge_ms = 0;  // monotonic, of this incarnation; 0 = none yet
  int64_t replay_samples = 0;  // of all pixels, that a replay asks for; 0 = it is none
  int64_t start_spp = 0;       // committed when this incarnation began
  int64_t start_samples = 0;   // in the film then
  v1::StopReason stop_reason = v1::STOP_REASON_SPP;  // once the queue is done
  bool has_picture = false;  // one has been made in this incarnation
  bool evaluating = false;                           // EvaluatePictureEffect is under way
  int64_t saved_film_ms = 0;
  bool film_changed = false;  // since it was saved
  bool film_final_stored = false;  // it is on disk as it will stay
  bool end_stored = false;         // the record that says that it has ended is on disk
  std::string store_failure;       // why its record could not be stored lately; empty = it could
  std::string last_decline;   // what the last worker said that declined

  double NsPerSample() const {
    return rendered_samples > 0 ? rendered_ns / rendered_samples : kUnknownNsPerSample;
  }
  bool IsTerminal() const {
    return record.state() == v1::JOB_STATE_DONE || record.state() == v1::JOB_STATE_CANCELLED ||
           record.state() == v1::JOB_STATE_FAILED;
  }
  bool IsOpen() const {
    return record.state() == v1::JOB_STATE_QUEUED || record.state() == v1::JOB_STATE_RUNNING;
  }
  // The only arithmetic that it may be rendered in: what was asked for, or that of the samples that
  // it has or that are on their way; empty = any.
  std::string PinnedArithmetic() const {
    if (!record.settings().arithmetic().empty()) return record.settings().arithmetic();
    const bool has_samples =
        film->samples() > 0 || !leases_of_unit.empty() || !audits.empty();
    return has_samples ? record.arithmetic() : std::string();
  }
  bool Admits(const std::string& arithmetic) const {
    const std::string pinned = PinnedArithmetic();
    return pinned.empty() || pinned == arithmetic;
  }
  // Whether the host has rendered the audited unit: what it would say again does not count.
  bool HasHeard(const std::string& host, const Unit& unit) const {
    const auto audit = audits.find(unit);
    return audit != audits.end() &&
           std::ranges::find(audit->second, host, &Testimony::host) != audit->second.end();
  }
  bool LacksMemory(const v1::Hello& hello) const {
    return hello.memory_bytes() <= memory_short_bytes;
  }
  int64_t ElapsedMs(int64_t now_ms) const { return spent_ms + (work_ms ? now_ms - work_ms : 0); }
};

struct Coordinator::Worker {
  SessionId session = 0;
  uint64_t id = 0;
  v1::Hello hello;
  Instant connected;
  Instant seen;
  bool draining = false;
  bool is_alone = false;  // it renders a suspect, and nothing else
  bool reserved = false;  // it gets nothing until it is idle: a suspect waits for it
  bool has_sent = false;  // a delta, since its last heartbeat
  bool stalled = false;   // it lives, but lets leases expire: one at a time until one moves
  std::set<LeaseId> leases;
  std::set<JobId> known_jobs;  // JobSpec sent
  // Jobs whose assets it could not fetch or whose scene it could not build -> not before this
  // monotonic moment.
  std::map<JobId, int64_t> retry_assets_ms;
  // Whose scenes it builds: since when, and when it last said so; monotonic.
  struct Building {
    int64_t since_ms = 0;
    int64_t said_ms = 0;
  };
  std::map<JobId, Building> building;
  // One of them has not come in time: until then it gets nothing that has to be built, so that it
  // sees that nobody waits for that scene, whatever jobs have it.
  int64_t no_builds_before_ms = 0;
  std::set<JobId> built;  // whose scenes it has, as far as is known
  int64_t samples = 0;
  std::map<JobId, double> ns_per_sample;  // of one thread, lately
  double render_ms = 0;  // of a lease, lately; 0 = unknown
  std::set<LeaseId> filter_leases;
  int64_t filtered_windows = 0;
  int64_t filter_not_before_ms = 0;  // monotonic
  int64_t filter_put_off_ms = 0;     // for how long, the last time that one was lost; 0 = none was
  double slowness = 1;  // its time over the average worker's, lately

  bool RetriesLater(JobId job, int64_t now_ms) const {
    if (now_ms < no_builds_before_ms && !built.contains(job)) return true;
    const auto retry = retry_assets_ms.find(job);
    return retry != retry_assets_ms.end() && now_ms < retry->second;
  }
  // Of an ISA class; empty if it does not run that.
  std::string ArithmeticOf(const std::string& isa) const {
    const auto& classes = hello.isa_classes();
    const auto found = std::ranges::find(classes, isa);
    if (found == classes.end()) return std::string();
    return hello.arithmetic(static_cast<int>(found - classes.begin()));
  }
};

}  // namespace tessera
