// The job catalogue: one SQLite file (WAL), one row a job.
// Threads: all methods from any thread.
#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/store/job_storage.h"

struct sqlite3;

namespace tessera {

class Catalogue : public RowStorage {
 public:
  // Opens or creates the file, and brings one of an earlier version up to this one's.
  // Errors: INTERNAL naming the file and SQLite's reason; FAILED_PRECONDITION if a later version
  // has written it.
  static absl::StatusOr<std::unique_ptr<Catalogue>> Open(const std::string& path);
  ~Catalogue() override;

  absl::Status Put(const CatalogueRow& row) override;
  absl::Status Remove(uint64_t job) override;
  absl::StatusOr<std::vector<CatalogueRow>> ReadAll() override;
  absl::Status PutBan(const BanRow& ban) override;
  absl::StatusOr<std::vector<BanRow>> ReadBans() override;
  absl::Status ForgetBans();
  // Counts the runs of the server on this catalogue, starting with 1.
  absl::StatusOr<uint64_t> NextIncarnation();
  // The largest id that any job ever had; ids are not used twice.
  absl::StatusOr<uint64_t> LastJob();

 private:
  explicit Catalogue(std::string path) : path_(std::move(path)) {}
  absl::Status Execute(const char* sql);
  absl::Status Migrate();
  absl::Status Error(const char* what) const;

  const std::string path_;
  std::mutex mu_;  // guards db_
  sqlite3* db_ = nullptr;
};

}  // namespace tessera
