// Makes jobs survive the server: writes catalogue rows and film checkpoints in the background,
// always the latest state.
#pragma once

#include <condition_variable>
#include <map>
#include <mutex>
#include <set>
#include <thread>

#include "absl/status/status.h"
#include "server/coordinator_host.h"
#include "server/store/asset_store.h"
#include "server/store/catalogue.h"
#include "server/store/film_store.h"

namespace tessera {

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
  // Writes the job's record before it returns.
  absl::Status SaveNow(JobId job);
  // Writes what is pending, and the films of all jobs under way, and ends. Idempotent.
  void Stop();

 private:
  struct Request {
    bool film = false;
    bool remove = false;
  };
  void Run();
  void Write(JobId job, const Request& request);
  absl::Status WriteRecord(JobId job);

  Catalogue* const catalogue_;
  FilmStore* const films_;
  AssetStore* const assets_;
  CoordinatorHost* host_ = nullptr;  // constant after Start

  std::mutex record_mu_;  // held from reading a record to its being in the catalogue
  std::mutex mu_;         // guards all below
  std::condition_variable wake_;
  std::map<JobId, Request> pending_;
  bool stopping_ = false;
  std::thread thread_;
};

}  // namespace tessera
