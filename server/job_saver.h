// Makes jobs survive the server: writes catalogue rows and film checkpoints in the background,
// always the latest state, and again later what could not be written.
#pragma once

#include <chrono>
#include <condition_variable>
#include <map>
#include <mutex>
#include <thread>

#include "absl/status/status.h"
#include "server/coordinator_host.h"
#include "server/store/asset_store.h"
#include "server/store/catalogue.h"
#include "server/store/film_store.h"

namespace tessera {

// What is on disk at any moment: a record that says that the job has ended has its whole film; any
// other record may be newer or older than the film, which says itself which samples it has.
// Threads: all methods from any thread.
class JobSaver {
 public:
  // catalogue, films: null when nothing is kept. All must outlive the saver; `host` is set later.
  JobSaver(Catalogue* catalogue, FilmStore* films, AssetStore* assets);
  ~JobSaver();  // Stop

  // Effects; never block. Nothing is written before Start.
  void Save(JobId job, bool with_film);
  void Remove(JobId job);

  void Start(CoordinatorHost* host);
  // The job is in the catalogue when it returns; its latest state too, unless that needs the film.
  absl::Status SaveNow(JobId job);
  // The job, which the coordinator has removed, is out of the catalogue when it returns.
  absl::Status RemoveNow(JobId job);
  // Writes what is pending, and the films of all jobs under way, and ends. Idempotent.
  void Stop();

 private:
  using Clock = std::chrono::steady_clock;
  struct Request {
    bool film = false;
    bool remove = false;
    Clock::time_point not_before{};
  };
  // A job as it was at one moment.
  struct Snapshot {
    v1::Job record;
    std::string request_id;
    std::shared_ptr<const Film> film;  // null when it is on disk only
  };
  void Run();
  // Waits until something is to be written, and takes it; false: stop.
  bool Next(JobId* job, Request* request);
  // Writes, and asks for it again later if that fails.
  void Write(JobId job, Request request);
  absl::Status WriteFilm(JobId job, const Film& film);
  absl::StatusOr<Snapshot> Read(JobId job) const;
  // Writes the record unless a later one is written, or the job is gone.
  absl::Status WriteRecord(JobId job, const Snapshot& snapshot);
  absl::Status RemoveRow(JobId job);

  Catalogue* const catalogue_;
  FilmStore* const films_;
  AssetStore* const assets_;
  CoordinatorHost* host_ = nullptr;  // constant after Start

  std::mutex record_mu_;                // held while a row is written; guards recorded_
  std::map<JobId, uint64_t> recorded_;  // revision counter of the row that was written last

  std::mutex mu_;  // guards all below
  std::condition_variable wake_;
  std::map<JobId, Request> pending_;
  bool stopping_ = false;
  std::thread thread_;
};

}  // namespace tessera
