// Makes jobs survive the server: writes catalogue rows and film checkpoints in the background,
// always the latest state, and again later what could not be written.
#pragma once

#include <chrono>
#include <condition_variable>
#include <functional>
#include <map>
#include <mutex>
#include <set>
#include <thread>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "server/coordinator_host.h"
#include "server/store/asset_store.h"
#include "server/store/job_storage.h"

namespace tessera {

// What is on disk at any moment: a record that says that the job has ended has its whole film; any
// other record may be newer or older than the film, which says itself which samples it has.
// Threads: all methods from any thread.
class JobSaver {
 public:
  using Clock = std::chrono::steady_clock;

  // catalogue, films: null when nothing is kept. All must outlive the saver; `host` is set later.
  JobSaver(RowStorage* catalogue, const FilmStorage* films, AssetStore* assets,
           std::function<Clock::time_point()> now = Clock::now);
  ~JobSaver();  // Stop

  // Effects; never block. Nothing is written before Start or WriteDue.
  void Save(JobId job, bool with_film);
  void Remove(JobId job);
  void SaveBan(const std::string& host, const std::string& reason);

  // With a thread that writes, or for a caller that does so himself, by WriteDue.
  void Start(CoordinatorHost* host);
  void Attach(CoordinatorHost* host) { host_ = host; }
  // Writes one job that is due, if there is one; returns whether there was.
  bool WriteDue();
  // The job's latest state is in the catalogue when it returns; of a job that has ended and whose
  // film is still to be written, that it is about to end.
  absl::Status SaveNow(JobId job);
  // The job, which the coordinator has removed, is out of the catalogue when it returns.
  absl::Status RemoveNow(JobId job);
  // Writes what is pending, and the films of all jobs under way, and ends. Idempotent.
  void Stop();

 private:
  struct Request {
    bool film = false;
    bool remove = false;
    Clock::time_point not_before{};
  };
  // A job as it was at one moment.
  struct Snapshot {
    v1::Job record;
    std::string request_id;
    std::string suspects;
    std::shared_ptr<const Film> film;  // null when it is on disk only
  };
  using Pending = std::map<JobId, Request>;
  static constexpr JobId kBans = 0;  // no job's: in Pending, that bans are to be written

  void Run();
  Pending::iterator NextLocked();  // what is due first
  // Waits until something is to be written, and takes it; false: stop.
  bool Next(JobId* job, Request* request);
  // Writes, and asks for it again later if that fails.
  void Write(JobId job, Request request);
  absl::Status WriteJob(JobId job, const Request& request);
  absl::Status WriteBans();
  // Tells the coordinator when the disk is full, and when it has room again.
  void NoteDisk(JobId job, const absl::Status& status);
  // Tells it which jobs cannot be written, and when they can again.
  void NoteFailure(JobId job, const absl::Status& status);
  absl::Status WriteFilm(JobId job, const Film& film);
  absl::StatusOr<Snapshot> Read(JobId job) const;
  // Writes the record unless a later one is written, or the job is gone. Of a job that has ended
  // and whose film is still to be written, may_end=false: that it is about to end. Tells the
  // coordinator when the record on disk says that the job has ended.
  absl::Status WriteRecord(JobId job, Snapshot snapshot, bool may_end);
  absl::Status RemoveRow(JobId job);

  RowStorage* const catalogue_;
  const FilmStorage* const films_;
  AssetStore* const assets_;
  const std::function<Clock::time_point()> now_;
  CoordinatorHost* host_ = nullptr;  // constant after Start or Attach

  std::mutex record_mu_;                // held while a row is written; guards recorded_
  // Of the row that was written last: its revision's counter, and whether it says that all is over.
  std::map<JobId, std::pair<uint64_t, bool>> recorded_;

  // Of the thread that writes: what found no room, and what was not written for any reason.
  std::set<JobId> full_, failing_;

  std::mutex mu_;  // guards all below
  std::condition_variable wake_;
  Pending pending_;
  std::vector<BanRow> bans_;  // to be written
  bool stopping_ = false;
  std::thread thread_;
};

}  // namespace tessera
