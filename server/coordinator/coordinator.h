// The coordinator's state machine: jobs, their films, workers and leases. Pure: the clock is handed
// in with each event, and all that has to happen outside comes back as effects. Restarting it from
// the catalogue and the film checkpoints (RestoreJobEvent) loses samples but no job, and never
// counts a sample twice.
//
// Fair shares: the highest priority that has work goes first; equal priorities share by the time
// that their leases take. A worker holds as many leases as it has threads, and a few more to hide
// latency.
// Threads: none; the caller serialises all calls.
#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/coordinator/effect.h"
#include "server/coordinator/event.h"
#include "server/coordinator/job_settings.h"
#include "server/coordinator/sample_plan.h"
#include "server/coordinator/tile_queue.h"
#include "server/coordinator/totals.h"

namespace tessera {

struct CoordinatorConfig {
  uint64_t incarnation = 1;  // differs between two runs of a server
  JobId first_job = 1;       // ids of new jobs begin here
  std::string version;       // workers must have the same
  SettingsDefaults defaults;
  // A lease that has made no progress for so long is another worker's.
  int64_t lease_ttl_ms = 2000;
  // How long a thread shall take for a lease: ranges are cut to its speed, and grow while deltas
  // keep the server busy.
  int64_t lease_target_ms = 500;
  int64_t checkpoint_interval_ms = 30000;
  // A scene that a worker has been building for so long counts as stuck there.
  int64_t build_budget_ms = 600000;
  // How many of all units are rendered a second time, on another host, and compared before they
  // count: 0 = none, 1 = all. Which ones they are is drawn from audit_seed, which nobody may guess.
  double audit_rate = 0;
  uint64_t audit_seed = 0;
  // Whether records are stored: then no job is shown as ended before that is stored.
  bool stores_records = false;
  // Of all films that are held in memory.
  int64_t film_bytes_max = int64_t{64} << 30;
};

class Coordinator {
 public:
  explicit Coordinator(CoordinatorConfig config);
  ~Coordinator();

  // Statuses: NOT_FOUND (job), INVALID_ARGUMENT (field and remedy; for worker events the session is
  // closed too), RESOURCE_EXHAUSTED (a limit), FAILED_PRECONDITION (the job's state, the worker's
  // version), ALREADY_EXISTS (a delta that is covered, which is dropped).
  StepResult Step(Event event, Instant now);

  // As clients see it: one whose end is not stored yet is still FINISHING. Errors: NOT_FOUND.
  absl::StatusOr<v1::Job> GetJob(JobId job) const;
  // As it is, with what only a restart of the server needs. Errors: NOT_FOUND.
  absl::StatusOr<v1::Job> RecordOf(JobId job) const;
  // Jobs with an id above `after`, ascending: at most `limit`, and bytes_max of their messages, but
  // one if there is any.
  std::vector<v1::Job> ListJobs(JobId after, size_t limit, size_t bytes_max = SIZE_MAX) const;
  std::vector<v1::Worker> ListWorkers(Instant now) const;
  CoordinatorTotals Totals() const;

  // Windows of the job's picture that workers would take now (FilterOfferEvent).
  int64_t FilterRoom(JobId job, Instant now) const;
  // The ticket of the window that this worker ("workers/N") has by that lease; 0 = none.
  uint64_t FilterTicketOf(const std::string& worker, LeaseId lease) const;
  struct FilterLeaseView {
    LeaseId id = 0;
    SessionId session = 0;
    uint64_t ticket = 0;
    int64_t expires_ms = 0;  // monotonic
  };
  std::vector<FilterLeaseView> ListFilterLeases() const;

  struct LeaseView {
    LeaseId id = 0;
    SessionId session = 0;
    JobId job = 0;
    Unit unit;
    int64_t expires_ms = 0;  // monotonic
    bool is_race = false;    // of a unit that another session has, too
    v1::LeaseProgress::State state = v1::LeaseProgress::STATE_UNSPECIFIED;  // as last reported
    int64_t samples = 0;     // done, as last reported
  };
  std::vector<LeaseView> ListLeases() const;

  // The job's film; null if the job does not exist, or has ended and its film is on disk only. Read
  // it only where Step cannot run, or after FinishJobEffect.
  std::shared_ptr<const Film> FilmOf(JobId job) const;
  // What the samples of a tile of that film have cost; nothing if the job does not exist.
  TileCost CostOf(JobId job, int64_t tile) const;
  // The job that a creation with this request_id made; 0 if none did, or it was deleted since.
  JobId JobOfRequest(const std::string& request_id) const;
  // The request_id that created the job; empty if there was none.
  std::string RequestIdOf(JobId job) const;
  // What has to survive a restart of what is known of the job's units and of who rendered them.
  v1::Suspects SuspectsOf(JobId job) const;
  v1::Contributions ContributionsOf(JobId job) const;
  // How often samples were taken out of the job's film, since the server was started.
  int64_t ResetsOf(JobId job) const;
  // The bytes that a film may take which a job of these complete settings is to go on from. Errors:
  // RESOURCE_EXHAUSTED, if there is no room for one.
  absl::StatusOr<int64_t> RoomForFilm(const v1::JobSettings& settings) const;
  // Whether the job exists and has not ended.
  bool IsUnfinished(JobId job) const;
  bool IsBanned(const std::string& host) const { return banned_.contains(host); }
  // Whether nothing is handed out, as nothing could be kept.
  bool IsDiskFull() const { return !disk_full_.empty(); }

 private:
  struct Job;
  struct Worker;
  struct Lease {
    SessionId session = 0;
    JobId job = 0;
    Unit unit;
    int64_t issued_ms = 0;
    int64_t expires_ms = 0;
    bool is_race = false;
    int turn = 1;  // its thread's, when it was given: behind the worker's other leases
    bool had_to_build = false;  // its scene first, as its worker has said
    v1::LeaseProgress::State state = v1::LeaseProgress::STATE_UNSPECIFIED;
    int64_t samples = 0;  // done, as far as it was told
  };
  struct FilterLease {
    SessionId session = 0;
    uint64_t ticket = 0;
    JobId job = 0;
    v1::FilterLease message;
    int64_t issued_ms = 0;
    int64_t expires_ms = 0;
  };
  struct RequestRecord {
    std::string kind;
    JobId job = 0;
  };

  // Events.
  void On(CreateJobEvent& event);
  void On(JobCommandEvent& event);
  void On(LookEvent& event);
  void On(RestoreJobEvent& event);
  void On(RestoreBanEvent& event);
  void On(DiskEvent& event);
  void On(RecordStoredEvent& event);
  void On(FilmStoredEvent& event);
  void On(WorkerConnectedEvent& event);
  void On(WorkerGoneEvent& event);
  void On(DeltaEvent& event);
  void On(HeartbeatEvent& event);
  void On(DeclineEvent& event);
  void On(SceneReadyEvent& event);
  void On(SceneFailureEvent& event);
  void On(DrainEvent& event);
  void On(PictureEvent& event);
  void On(FilterOfferEvent& event);
  void On(FilterWithdrawEvent& event);
  void On(FilteredEvent& event);
  void On(FilterLieEvent& event);
  void On(JobFinishedEvent& event);
  void On(TickEvent& event);

  // Jobs (coordinator_jobs.cpp).
  bool WithholdsEnd(const Job& job) const;
  Job* FindJob(JobId id);
  bool RepeatsRequest(const std::string& request_id, const std::string& kind, JobId* job);
  void RememberRequest(const std::string& request_id, const std::string& kind, JobId job);
  void ForgetRequest(const std::string& request_id);
  // OK, or the status that the client gets.
  absl::Status Pause(Job& job);
  absl::Status Resume(Job& job);
  absl::Status Cancel(Job& job);
  void Delete(JobId id);
  void SetState(Job& job, v1::JobState state);
  void StartQueue(Job& job);
  void MakeQueue(Job& job);
  void ApplyLook(Job& job);
  void Finish(Job& job, v1::StopReason reason);
  absl::Status CheckFirstFilm(const Job& job) const;
  absl::Status CheckFilmSize(const TileGrid& grid) const;
  void RestorePlan(Job& job);
  void ResetTile(Job& job, int64_t tile);
  void Fail(Job& job, const std::string& error);
  void StopWork(Job& job);
  void NextRevision(Job& job);
  void Touch(Job& job);
  void Save(Job& job, bool with_film);
  int64_t SamplesTotal(const Job& job) const;  // while it has a queue
  void UpdateProgress(Job& job);
  void DropStoredFilm(Job& job);

  // After a restart (coordinator_restore.cpp).
  void GoOn(Job& job);
  bool StartOver(Job& job);

  // Merging and stopping (coordinator_merge.cpp).
  absl::Status CheckDelta(const Job& job, const DeltaEvent& event) const;
  void Merge(Job& job, DeltaEvent& event);
  void OnPassCommitted(Job& job);
  void OnQueueDone(Job& job);
  void Evaluate(Job& job);
  std::optional<Unit> TakeUnit(Job& job, int64_t size_max);
  void OpenNextEpoch(Job& job);
  bool NextEpochFits(const Job& job) const;
  void NotePlanFloor(Job& job);
  void TakePlan(Job& job, std::vector<int64_t> plan);
  static bool MeetsTarget(const PictureEvent& picture, const v1::JobSettings& settings);
  void DecideNextPlan(Job& job, const PictureEvent& picture);
  std::vector<CellState> CellsOf(const Job& job, const std::vector<CellError>& errors) const;
  bool PlanFits(const Job& job, const std::vector<int64_t>& plan) const;
  void CheckTime(Job& job);

  // Units and workers that are not trusted (coordinator_trust.cpp).
  bool IsAudited(const Job& job, const Unit& unit) const;
  absl::Status Hear(Job& job, const Unit& unit, const std::string& host, const DeltaEvent& event,
                    std::vector<std::string>* liars);
  absl::Status HearDepth(Worker& worker, Job& job, const DeltaEvent& event);
  void StartOverAt(Job& job, int max_depth);
  void Ban(const std::string& host, const std::string& reason);
  void ResetTouched(Job& job, const std::string& host);
  void OnCrash(const std::string& host, const v1::CrashReport& report);
  void OnUnitCrashed(Job& job, const Unit& unit, const std::string& host,
                     const v1::CrashReport& report);
  void Convict(Job& job, const Unit& unit, const std::string& host, const v1::CrashReport& report);
  void GrantSuspects();
  void RestoreSuspects(Job& job, const v1::Suspects& suspects);
  void RestoreContributions(Job& job, const v1::Contributions& contributions);
  bool DropTouched(Job& job, const std::string& host);
  void DropTiles(Job& job, const std::set<int64_t>& tiles);
  void RenderAgain(Job& job);
  bool WasSuspect(Job& job, const Unit& unit);
  Worker* WorkerForSuspect(const Job& job, const std::set<std::string>& crash_hosts,
                           const std::set<std::string>& heard_hosts);
  std::optional<Unit> AuditFor(Job& job, const Worker& worker);
  bool KeepUnit(Job& job, const Unit& unit);
  void CloseQueue(Job& job);

  // Windows to be filtered (coordinator_filter.cpp).
  int64_t FilterRoomOf(const Worker& worker, const Job& job, int64_t now_ms) const;
  // Ends a lease without a result; the server filters the window.
  void LoseFilterLease(LeaseId id);
  void PutOffFiltering(Worker& worker);
  void LoseFilterLeasesOf(SessionId session);
  void RenewFilterLease(SessionId session, LeaseId id);
  void ExpireFilterLeases();

  // Workers and what they say (coordinator_workers.cpp).
  Worker* FindWorker(SessionId session);
  void Send(SessionId session, v1::CoordinatorMessage message);
  void CloseWorker(SessionId session, const absl::Status& status);
  void RemoveWorker(SessionId session);
  bool NoteProgress(const v1::LeaseProgress& progress, Lease* lease);
  void Renew(LeaseId id);
  void RenewFollowers(const Worker& worker);
  bool BuildMayGoOn(Worker& worker, JobId id);
  void DropLeasesOf(Worker& worker, JobId id, LeaseId but);

  // Leases (coordinator_leases.cpp).
  void GrantAll();
  bool GrantRound(const std::vector<Worker*>& workers, bool stalled);
  bool GrantOne(Worker& worker);
  bool GrantFrom(std::vector<Job*>& jobs, Worker& worker);
  int64_t LeaseSize(const Worker& worker, const Job& job) const;
  void NoteSpeed(Worker& worker, const Lease& lease, const DeltaEvent& event);
  void NoteIngest(double load);
  void Grant(Worker& worker, Job& job, const Unit& unit);
  size_t LeasesAhead(const Worker& worker) const;
  size_t LeasesMax(const Worker& worker) const;
  size_t LeaseBatch(const Worker& worker) const;
  bool CanServe(const Worker& worker, const Job& job) const;
  void DropLease(LeaseId id, bool revoke);
  void DropLeasesOf(Job& job, const Unit& unit);
  void ExpireLeases();
  bool IsSilent(const Worker& worker) const;
  bool FitsMemory(const Job& job) const;
  void CountFilm(Job& job);

  // Leases that take long (coordinator_races.cpp).
  void NoteWait(const Lease& lease, const DeltaEvent& event);
  void TakeWait();
  void RaceIdleWorkers();
  bool MayRace(const Lease& lease) const;
  void Race(Worker& worker, std::vector<LeaseId>* leases);

  // Why jobs wait (coordinator_waiting.cpp).
  void UpdateWaiting();
  void UpdateWaitingOf(Job& job);
  std::string WaitingReason(const Job& job) const;
  std::string ReasonOfWorkers(const Job& job) const;

  CoordinatorConfig config_;
  Instant now_;
  StepResult result_;  // of the step under way

  CoordinatorTotals totals_;  // what has happened; Totals adds what is now
  uint64_t revision_ = 0;
  JobId next_job_;
  LeaseId next_lease_ = 1;
  double lease_scale_ = 1;  // of lease_target_ms, by the server's load
  uint64_t next_worker_ = 1;
  std::map<JobId, std::unique_ptr<Job>> jobs_;
  std::set<std::pair<int, JobId>> order_;  // (-priority, job) of jobs that want leases
  int64_t film_bytes_ = 0;                 // of the jobs that hold films in memory
  bool waiting_changed_ = false;           // any job's reason to wait may have changed
  std::set<JobId> waiting_changed_of_;     // these jobs' reasons may have
  std::map<SessionId, std::unique_ptr<Worker>> workers_;
  // Who is asked at the end of a step: those of whom something was heard or whose lease has ended,
  // or everybody once there may be units again for workers that found none.
  std::set<SessionId> may_take_;
  bool units_changed_ = false;
  std::map<LeaseId, Lease> leases_;
  // How long deltas wait for the server: since the last tick by (session, ms), and lately.
  std::vector<std::pair<SessionId, double>> waits_;
  double wait_ms_ = 0;
  std::set<JobId> suspicious_;        // jobs with suspects
  std::set<std::string> banned_;      // hosts that returned wrong bits
  std::string disk_full_;             // why nothing can be kept; empty = it can
  std::map<LeaseId, FilterLease> filter_leases_;
  std::set<std::pair<int64_t, LeaseId>> expiries_;  // (expires_ms, lease)
  std::map<std::string, RequestRecord> requests_;
  std::deque<std::string> request_order_;  // oldest first
};

// "jobs/N" and back. Errors: INVALID_ARGUMENT.
std::string JobName(JobId id);
absl::StatusOr<JobId> ParseJobName(const std::string& name);

}  // namespace tessera
