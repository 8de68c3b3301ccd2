// Units that crash workers, and workers that return wrong bits.
//
// A suspect, a unit that was being rendered when a worker crashed, is retried alone. When it has
// crashed two workers that did nothing else, it is split; a half that crashes a third one is to
// blame, and its job fails. Wherever there is a choice, another host tries. An audited unit counts
// once two hosts have returned the same bits; who returned others is banned, and what it has added
// to films without an audit is rendered again.
#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/coordinator/coordinator.h"
#include "server/coordinator/coordinator_state.h"
#include "server/coordinator/limits.h"
#include "server/coordinator/worker_message.h"

namespace tessera {
namespace {

constexpr int kCrashesBeforeSplit = 2;
constexpr int kAuditScanMax = 64;
constexpr size_t kBuildCrashesMax = 3;
constexpr int64_t kDepthRetryMs = 60000;
constexpr size_t kDepthHostsMax = 64;

// SplitMix64's finaliser (Steele, Lea & Flood 2014).
uint64_t Mix(uint64_t x) {
  x += 0x9e3779b97f4a7c15u;
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9u;
  x = (x ^ (x >> 27)) * 0x94d049bb133111ebu;
  return x ^ (x >> 31);
}

std::string NameOf(const v1::CrashReport& report) {
  if (report.cause() == v1::CrashReport::CAUSE_OUT_OF_MEMORY) return "out of memory";
  return absl::StrCat("signal ", report.signal());
}

}  // namespace

bool Coordinator::IsAudited(const Job& job, const Unit& unit) const {
  if (config_.audit_rate <= 0) return false;
  uint64_t hash = Mix(config_.audit_seed ^ job.id);
  for (const int64_t number : {unit.tile, unit.range.begin, unit.range.end}) {
    hash = Mix(hash ^ static_cast<uint64_t>(number));
  }
  return static_cast<double>(hash >> 11) * 0x1p-53 < config_.audit_rate;
}

// OK once two hosts agree on the unit; `liars` are then those who said otherwise.
absl::Status Coordinator::Hear(Job& job, const Unit& unit, const std::string& host,
                               const DeltaEvent& event, std::vector<std::string>* liars) {
  std::vector<Testimony>& heard = job.audits[unit];
  if (!job.queue->Claim(unit)) return absl::FailedPreconditionError("not asked for");
  if (job.leases_of_unit.contains(unit) || job.suspects.contains(unit)) {
    job.audits_waiting.erase(unit);
  } else {
    job.audits_waiting.insert(unit);
  }
  if (std::ranges::find(heard, host, &Testimony::host) != heard.end()) {
    return absl::AlreadyExistsError(absl::StrCat(host, " has rendered this unit before"));
  }
  const Sha256Digest digest = event.digest ? *event.digest : TestimonyOf(event.tile);
  if (std::ranges::find(heard, digest, &Testimony::digest) == heard.end()) {
    if (!heard.empty()) {
      result_.effects.emplace_back(AuditDiffersEffect{job.id, unit, host, heard.front().host});
    }
    heard.push_back({host, digest});
    if (heard.size() >= kTestimoniesMax) {
      Fail(job, absl::StrCat("tile ", unit.tile, ", samples [", unit.range.begin, ", ",
                             unit.range.end, "): ", heard.size(), " hosts have rendered it and no "
                             "two of them agree: check that all run the same build on sound "
                             "hardware, then submit it again"));
    }
    return absl::AbortedError("another host must render the same samples before they count");
  }
  for (const Testimony& testimony : heard) {
    if (testimony.digest != digest) liars->push_back(testimony.host);
  }
  return absl::OkStatus();
}

// The pilot is a function of the job: who finds another number than the others miscalculates, and
// both kinds of samples must not be mixed. The first number holds until two hosts have found
// another and no two that one. Errors: the delta does not count.
absl::Status Coordinator::HearDepth(Worker& worker, Job& job, const DeltaEvent& event) {
  if (!job.record.settings().auto_depth()) return absl::OkStatus();
  const int found = event.delta.max_depth();
  const std::string& host = worker.hello.host();
  if (job.depths_found.size() < kDepthHostsMax || job.depths_found.contains(host)) {
    job.depths_found[host] = found;
  }
  if (!job.record.has_max_depth() || found == job.record.max_depth()) return absl::OkStatus();
  const auto hosts_of = [&](int depth) {
    return std::ranges::count_if(job.depths_found,
                                 [&](const auto& entry) { return entry.second == depth; });
  };
  if (hosts_of(found) > 1 && hosts_of(job.record.max_depth()) < 2) {
    StartOverAt(job, found);
    return absl::AbortedError("the job starts over");
  }
  job.last_decline = CutText(
      absl::StrCat("the pilot of ", host, " has found --max-depth ", found,
                   ", the job's samples have ", job.record.max_depth(),
                   ": check the machines' memory and builds, or submit it with a number"),
      kErrorBytesMax);
  worker.retry_assets_ms[job.id] = now_.monotonic_ms + kDepthRetryMs;
  DropLeasesOf(worker, job.id, event.delta.lease_id());
  return absl::FailedPreconditionError(job.last_decline);
}

// The samples that it has are of another depth than most workers find.
void Coordinator::StartOverAt(Job& job, int max_depth) {
  StopWork(job);
  std::set<int64_t> all;
  for (int64_t tile = 0; tile < job.grid.num_tiles(); ++tile) all.insert(tile);
  job.plan.clear();
  DropTiles(job, all);
  job.record.set_max_depth(max_depth);
  for (auto& [session, worker] : workers_) worker->retry_assets_ms.erase(job.id);
  RenderAgain(job);
}

// A unit that waits for another host than those that have rendered it.
std::optional<Unit> Coordinator::AuditFor(Job& job, const Worker& worker) {
  int scanned = 0;
  for (auto unit = job.audits_waiting.begin();
       unit != job.audits_waiting.end() && scanned < kAuditScanMax; ++unit, ++scanned) {
    if (job.HasHeard(worker.hello.host(), *unit)) continue;
    const Unit found = *unit;
    job.audits_waiting.erase(unit);
    return found;
  }
  return std::nullopt;
}

void Coordinator::Ban(const std::string& host, const std::string& reason) {
  if (banned_.size() >= kBannedHostsMax) return;
  banned_.insert(host);
  result_.effects.emplace_back(BanEffect{host, reason});
  std::vector<SessionId> sessions;
  for (const auto& [session, worker] : workers_) {
    if (worker->hello.host() == host) sessions.push_back(session);
  }
  for (const SessionId session : sessions) {
    result_.effects.emplace_back(
        CloseSessionEffect{session, absl::PermissionDeniedError(reason)});
    RemoveWorker(session);
  }
  for (const auto& [id, job] : jobs_) {
    if (job->queue != nullptr) ResetTouched(*job, host);
  }
}

// Takes what the host has touched out of the film. Whole tiles start over: their samples cannot be
// told apart any more. A job that decides by its picture starts over as a whole, as the decisions
// rested on that picture. Returns whether there was anything.
bool Coordinator::DropTouched(Job& job, const std::string& host) {
  const auto touched = job.rendered_by.find(host);
  if (touched == job.rendered_by.end()) return false;
  std::set<int64_t> tiles;
  for (const Unit& unit : touched->second) tiles.insert(unit.tile);
  if (DecidesByPicture(job.record.settings())) {
    for (int64_t tile = 0; tile < job.grid.num_tiles(); ++tile) tiles.insert(tile);
    job.plan.clear();
  }
  job.rendered_by.erase(touched);
  DropTiles(job, tiles);
  return true;
}

// Takes whole tiles out of the film.
void Coordinator::DropTiles(Job& job, const std::set<int64_t>& tiles) {
  ++job.resets;
  for (const int64_t tile : tiles) {
    ResetTile(job, tile);
    result_.effects.emplace_back(TileChangedEffect{job.id, tile});
  }
  for (auto& [other, units] : job.rendered_by) {
    std::erase_if(units, [&](const Unit& unit) { return tiles.contains(unit.tile); });
  }
  v1::JobProgress& progress = *job.record.mutable_progress();
  progress.set_rays(0);
  progress.set_delta_bytes(0);
  progress.set_render_core_seconds(0);
  for (const TileCost& cost : job.costs) AddCost(cost, &progress);
  CountFilm(job);
  if (job.record.settings().auto_depth() && job.film->samples() == 0) {
    job.record.clear_max_depth();
  }
}

void Coordinator::ResetTouched(Job& job, const std::string& host) {
  if (!job.rendered_by.contains(host)) return;
  StopWork(job);
  DropTouched(job, host);
  RenderAgain(job);
}

// What tiles have lost that were dropped, with nobody at work on the job.
void Coordinator::RenderAgain(Job& job) {
  job.audits.clear();
  job.audits_waiting.clear();
  job.suspects.clear();
  job.evaluating = false;
  job.stop_reason = v1::STOP_REASON_SPP;
  job.first_merge_ms = 0;
  StartQueue(job);
  Touch(job);
  Save(job, true);
}

void Coordinator::OnCrash(const std::string& host, const v1::CrashReport& report) {
  for (const v1::CrashReport::Unit& named : report.units()) {
    const absl::StatusOr<JobId> id = ParseJobName(named.job());
    const auto job = id.ok() ? jobs_.find(*id) : jobs_.end();
    if (job == jobs_.end() || job->second->queue == nullptr) continue;
    Save(*job->second, false);
    OnUnitCrashed(*job->second,
                  {named.tile_index(), {named.sample_begin(), named.sample_end()}}, host, report);
  }
  const absl::StatusOr<JobId> built = ParseJobName(report.building_job());
  const auto job = built.ok() ? jobs_.find(*built) : jobs_.end();
  if (job == jobs_.end() || job->second->queue == nullptr) return;
  job->second->build_crashes.insert({host, report.process_id()});
  Save(*job->second, false);
  if (job->second->build_crashes.size() < kBuildCrashesMax) return;
  Fail(*job->second,
       absl::StrCat("building the scene has crashed ", kBuildCrashesMax, " workers (the last one: ",
                    host, ", ", NameOf(report), "): the scene, or this version, has a fault; try "
                    "it with 'tessera info', or workers with more memory"));
}

void Coordinator::OnUnitCrashed(Job& job, const Unit& unit, const std::string& host,
                                const v1::CrashReport& report) {
  if (!job.queue->Claim(unit)) return;  // somebody has rendered it
  Suspect& suspect = job.suspects[unit];
  suspicious_.insert(job.id);
  if (!suspect.processes.insert({host, report.process_id()}).second) return;
  suspect.hosts.insert(host);
  if (report.units_size() != 1) return;
  ++suspect.crashes_alone;
  if (suspect.is_half || (unit.range.size() == 1 && suspect.crashes_alone > kCrashesBeforeSplit)) {
    Convict(job, unit, host, report);
  } else if (suspect.crashes_alone >= kCrashesBeforeSplit && unit.range.size() > 1) {
    DropLeasesOf(job, unit);
    Suspect half = std::move(suspect);
    half.is_half = true;
    job.suspects.erase(unit);
    job.audits.erase(unit);
    job.audits_waiting.erase(unit);
    for (const Unit& part : job.queue->Split(unit)) job.suspects[part] = half;
  }
}

void Coordinator::Convict(Job& job, const Unit& unit, const std::string& host,
                          const v1::CrashReport& report) {
  const Suspect& suspect = job.suspects.at(unit);
  Fail(job, absl::StrCat("tile ", unit.tile, ", samples [", unit.range.begin, ", ", unit.range.end,
                         ") has crashed ", suspect.processes.size(), " workers on ",
                         suspect.hosts.size(), " hosts (the last one: ", host, ", ",
                         NameOf(report), "), also when rendered alone: the scene, or this version, "
                         "has a fault there; report it, or leave those pixels out (--region)"));
}

// The idlest one that may; of another host than those that have crashed, where there is one, and
// never of one that has said what it has to say of the unit.
Coordinator::Worker* Coordinator::WorkerForSuspect(const Job& job,
                                                   const std::set<std::string>& crash_hosts,
                                                   const std::set<std::string>& heard_hosts) {
  Worker* best = nullptr;
  bool best_is_new = false;
  for (auto& [session, worker] : workers_) {
    if (worker->is_alone || worker->reserved || IsSilent(*worker) || !CanServe(*worker, job) ||
        heard_hosts.contains(worker->hello.host())) {
      continue;
    }
    const bool is_new = !crash_hosts.contains(worker->hello.host());
    if (best != nullptr && best_is_new && !is_new) continue;
    if (best == nullptr || is_new != best_is_new || worker->leases.size() < best->leases.size()) {
      best = worker.get();
      best_is_new = is_new;
    }
  }
  return best;
}

// Suspects come first, each with a worker of its own; a busy one gets nothing more until idle.
void Coordinator::GrantSuspects() {
  if (suspicious_.empty()) return;
  for (auto& [session, worker] : workers_) {
    worker->reserved = false;
    worker->is_alone = worker->is_alone && !worker->leases.empty();
  }
  for (auto id = suspicious_.begin(); id != suspicious_.end();) {
    const auto found = jobs_.find(*id);
    if (found == jobs_.end() || found->second->suspects.empty()) {
      id = suspicious_.erase(id);
      continue;
    }
    ++id;
    Job& job = *found->second;
    if (!job.IsOpen() || !FitsMemory(job)) continue;
    for (const auto& [unit, suspect] : job.suspects) {
      if (job.leases_of_unit.contains(unit)) continue;
      std::set<std::string> heard;
      if (const auto audit = job.audits.find(unit); audit != job.audits.end()) {
        for (const Testimony& testimony : audit->second) heard.insert(testimony.host);
      }
      Worker* const worker = WorkerForSuspect(job, suspect.hosts, heard);
      if (worker == nullptr) continue;
      worker->reserved = true;
      if (!worker->leases.empty() || !worker->filter_leases.empty()) continue;
      worker->is_alone = true;
      job.audits_waiting.erase(unit);
      Grant(*worker, job, unit);
    }
  }
  if (!suspicious_.empty()) return;
  for (auto& [session, worker] : workers_) worker->is_alone = worker->reserved = false;
}

// No sample is wanted any more: nothing is to be blamed on units either. Who has rendered what is
// kept until the job has ended.
void Coordinator::CloseQueue(Job& job) {
  job.queue.reset();
  job.audits.clear();
  job.audits_waiting.clear();
  job.suspects.clear();
  job.past_suspects.clear();
  job.build_crashes.clear();
}

void Coordinator::On(RestoreBanEvent& event) {
  if (banned_.size() < kBannedHostsMax) banned_.insert(event.host);
}

void Coordinator::On(DiskEvent& event) {
  disk_full_ = CutText(event.full, kErrorBytesMax);
  waiting_changed_ = true;
}

v1::Suspects Coordinator::SuspectsOf(JobId id) const {
  v1::Suspects out;
  const auto job = jobs_.find(id);
  if (job == jobs_.end()) return out;
  std::map<Unit, Suspect> all = job->second->suspects;
  all.insert(job->second->past_suspects.begin(), job->second->past_suspects.end());
  for (const auto& [unit, suspect] : all) {
    v1::SuspectUnit& to = *out.add_units();
    to.set_tile(unit.tile);
    to.set_sample_begin(unit.range.begin);
    to.set_sample_end(unit.range.end);
    to.set_crashes_alone(suspect.crashes_alone);
    to.set_is_half(suspect.is_half);
    for (const auto& [host, process] : suspect.processes) {
      v1::SuspectUnit::Process& one = *to.add_processes();
      one.set_host(host);
      one.set_process_id(process);
    }
  }
  for (const auto& [host, process] : job->second->build_crashes) {
    v1::SuspectUnit::Process& one = *out.add_build_crashes();
    one.set_host(host);
    one.set_process_id(process);
  }
  return out;
}

int64_t Coordinator::ResetsOf(JobId id) const {
  const auto job = jobs_.find(id);
  return job == jobs_.end() ? 0 : job->second->resets;
}

v1::Contributions Coordinator::ContributionsOf(JobId id) const {
  v1::Contributions out;
  const auto job = jobs_.find(id);
  if (job == jobs_.end()) return out;
  for (const auto& [host, units] : job->second->rendered_by) {
    v1::Contribution& to = *out.add_hosts();
    to.set_host(host);
    for (const Unit& unit : units) {
      to.add_tiles(unit.tile);
      to.add_sample_begins(unit.range.begin);
      to.add_sample_ends(unit.range.end);
    }
  }
  return out;
}

// Who is in the film of before a restart. What hosts have added that are banned starts over.
void Coordinator::RestoreContributions(Job& job, const v1::Contributions& contributions) {
  for (const v1::Contribution& from : contributions.hosts()) {
    const int count = std::min({from.tiles_size(), from.sample_begins_size(),
                                from.sample_ends_size()});
    for (int i = 0; i < count; ++i) {
      if (from.tiles(i) < 0 || from.tiles(i) >= job.grid.num_tiles()) continue;
      job.rendered_by[from.host()].push_back(
          {from.tiles(i), {from.sample_begins(i), from.sample_ends(i)}});
    }
  }
  bool any = false;
  for (const std::string& host : banned_) any = DropTouched(job, host) || any;
  if (any) Save(job, true);
}

void Coordinator::RestoreSuspects(Job& job, const v1::Suspects& suspects) {
  for (const v1::SuspectUnit& from : suspects.units()) {
    const Unit unit{from.tile(), {from.sample_begin(), from.sample_end()}};
    if (unit.range.size() < 1) continue;
    Suspect& suspect = job.past_suspects[unit];
    suspect.crashes_alone = from.crashes_alone();
    suspect.is_half = from.is_half();
    for (const auto& process : from.processes()) {
      suspect.processes.insert({process.host(), process.process_id()});
      suspect.hosts.insert(process.host());
    }
  }
  for (const auto& process : suspects.build_crashes()) {
    job.build_crashes.insert({process.host(), process.process_id()});
  }
}

// Whether an earlier run of the server has suspected the unit, or one that shares samples with it:
// then it is one again, and no longer the queue's.
bool Coordinator::WasSuspect(Job& job, const Unit& unit) {
  bool was = false;
  Suspect joined;
  for (auto it = job.past_suspects.begin(); it != job.past_suspects.end();) {
    const auto& [past, suspect] = *it;
    if (past.tile != unit.tile || past.range.end <= unit.range.begin ||
        past.range.begin >= unit.range.end) {
      ++it;
      continue;
    }
    was = true;
    joined.crashes_alone = std::max(joined.crashes_alone, suspect.crashes_alone);
    joined.is_half = joined.is_half || (suspect.is_half && past.range.size() >= unit.range.size());
    joined.hosts.insert(suspect.hosts.begin(), suspect.hosts.end());
    joined.processes.insert(suspect.processes.begin(), suspect.processes.end());
    const bool is_within =
        unit.range.begin <= past.range.begin && past.range.end <= unit.range.end;
    it = is_within ? job.past_suspects.erase(it) : std::next(it);
  }
  if (!was) return false;
  job.suspects[unit] = std::move(joined);
  suspicious_.insert(job.id);
  return true;
}

// Whether a unit that nobody renders any more stays out of the queue, for the rules above.
bool Coordinator::KeepUnit(Job& job, const Unit& unit) {
  const bool is_suspect = job.suspects.contains(unit);
  const bool is_audited = job.audits.contains(unit);
  if (is_audited && !is_suspect) job.audits_waiting.insert(unit);
  return is_suspect || is_audited;
}

}  // namespace tessera
