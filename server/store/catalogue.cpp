#include "server/store/catalogue.h"

#include <sqlite3.h>

#include <cerrno>

#include "absl/strings/str_cat.h"

namespace tessera {
namespace {

constexpr char kSchema[] =
    "PRAGMA journal_mode = WAL;"
    "PRAGMA synchronous = FULL;"
    "PRAGMA busy_timeout = 5000;"
    "CREATE TABLE IF NOT EXISTS jobs (job INTEGER PRIMARY KEY, request_id TEXT NOT NULL,"
    "  record BLOB NOT NULL);"
    "CREATE TABLE IF NOT EXISTS counters (name TEXT PRIMARY KEY, value INTEGER NOT NULL);";

// Of the file, in its user_version; 0 is that of the first files.
constexpr int64_t kSchemaVersion = 2;
constexpr char kToVersion2[] =
    "BEGIN IMMEDIATE;"
    "ALTER TABLE jobs ADD COLUMN suspects BLOB NOT NULL DEFAULT x'';"
    "CREATE TABLE bans (host TEXT PRIMARY KEY, reason TEXT NOT NULL);"
    "PRAGMA user_version = 2;"
    "COMMIT;";

// A prepared statement that is finalised when it goes.
class Statement {
 public:
  Statement(sqlite3* db, const char* sql) {
    sqlite3_prepare_v2(db, sql, -1, &statement_, nullptr);
  }
  ~Statement() { sqlite3_finalize(statement_); }
  Statement(const Statement&) = delete;
  Statement& operator=(const Statement&) = delete;

  bool ok() const { return statement_ != nullptr; }
  void Bind(int index, int64_t value) { sqlite3_bind_int64(statement_, index, value); }
  void BindBlob(int index, const std::string& value) {
    sqlite3_bind_blob64(statement_, index, value.data(), value.size(), SQLITE_TRANSIENT);
  }
  void BindText(int index, const std::string& value) {
    sqlite3_bind_text64(statement_, index, value.data(), value.size(), SQLITE_TRANSIENT,
                        SQLITE_UTF8);
  }
  int Step() { return sqlite3_step(statement_); }
  int64_t Integer(int column) { return sqlite3_column_int64(statement_, column); }
  std::string Bytes(int column) {
    const void* const data = sqlite3_column_blob(statement_, column);
    const auto size = static_cast<size_t>(sqlite3_column_bytes(statement_, column));
    return data == nullptr ? "" : std::string(static_cast<const char*>(data), size);
  }

 private:
  sqlite3_stmt* statement_ = nullptr;
};

}  // namespace

absl::StatusOr<std::unique_ptr<Catalogue>> Catalogue::Open(const std::string& path) {
  std::unique_ptr<Catalogue> catalogue(new Catalogue(path));
  if (sqlite3_open(path.c_str(), &catalogue->db_) != SQLITE_OK) return catalogue->Error("open");
  if (absl::Status status = catalogue->Execute(kSchema); !status.ok()) return status;
  if (absl::Status status = catalogue->Migrate(); !status.ok()) return status;
  return catalogue;
}

absl::Status Catalogue::Migrate() {
  int64_t version = 0;
  {
    std::lock_guard lock(mu_);
    Statement read(db_, "PRAGMA user_version");
    if (!read.ok() || read.Step() != SQLITE_ROW) return Error("read");
    version = read.Integer(0);
  }
  if (version > kSchemaVersion) {
    return absl::FailedPreconditionError(absl::StrCat(
        "the job catalogue ", path_, " is of version ", version, ", this server knows ",
        kSchemaVersion, ": start the later tessera-server, or choose another --data-dir"));
  }
  return version < kSchemaVersion ? Execute(kToVersion2) : absl::OkStatus();
}

Catalogue::~Catalogue() { sqlite3_close(db_); }

absl::Status Catalogue::Error(const char* what) const {
  const int cause = sqlite3_system_errno(db_);
  if (sqlite3_errcode(db_) == SQLITE_FULL || cause == ENOSPC || cause == EDQUOT ||
      cause == EFBIG) {
    return absl::ResourceExhaustedError(
        absl::StrCat("cannot ", what, " the job catalogue ", path_, ": the disk is full; free "
                     "some space"));
  }
  return absl::InternalError(absl::StrCat("cannot ", what, " the job catalogue ", path_, ": ",
                                          sqlite3_errmsg(db_),
                                          "; check the disk, or choose another --data-dir"));
}

absl::Status Catalogue::Execute(const char* sql) {
  std::lock_guard lock(mu_);
  if (sqlite3_exec(db_, sql, nullptr, nullptr, nullptr) != SQLITE_OK) return Error("prepare");
  return absl::OkStatus();
}

absl::Status Catalogue::Put(const CatalogueRow& row) {
  std::lock_guard lock(mu_);
  Statement put(db_, "INSERT OR REPLACE INTO jobs (job, request_id, record, suspects) "
                "VALUES (?1, ?2, ?3, ?4)");
  Statement last(db_,
                 "INSERT INTO counters VALUES ('last_job', ?1) ON CONFLICT (name) DO UPDATE SET "
                 "value = max(value, excluded.value)");
  if (!put.ok() || !last.ok()) return Error("write");
  put.Bind(1, static_cast<int64_t>(row.job));
  put.BindText(2, row.request_id);
  put.BindBlob(3, row.record);
  put.BindBlob(4, row.suspects);
  last.Bind(1, static_cast<int64_t>(row.job));
  if (sqlite3_exec(db_, "BEGIN IMMEDIATE", nullptr, nullptr, nullptr) == SQLITE_OK &&
      put.Step() == SQLITE_DONE && last.Step() == SQLITE_DONE &&
      sqlite3_exec(db_, "COMMIT", nullptr, nullptr, nullptr) == SQLITE_OK) {
    return absl::OkStatus();
  }
  const absl::Status status = Error("write");
  if (sqlite3_get_autocommit(db_) == 0) {
    sqlite3_exec(db_, "ROLLBACK", nullptr, nullptr, nullptr);
  }
  return status;
}

absl::Status Catalogue::Remove(uint64_t job) {
  std::lock_guard lock(mu_);
  Statement remove(db_, "DELETE FROM jobs WHERE job = ?1");
  if (!remove.ok()) return Error("write");
  remove.Bind(1, static_cast<int64_t>(job));
  return remove.Step() == SQLITE_DONE ? absl::OkStatus() : Error("write");
}

absl::StatusOr<std::vector<CatalogueRow>> Catalogue::ReadAll() {
  std::lock_guard lock(mu_);
  Statement read(db_, "SELECT job, request_id, record, suspects FROM jobs ORDER BY job");
  if (!read.ok()) return Error("read");
  std::vector<CatalogueRow> rows;
  int result = SQLITE_ROW;
  while ((result = read.Step()) == SQLITE_ROW) {
    rows.push_back({static_cast<uint64_t>(read.Integer(0)), read.Bytes(1), read.Bytes(2),
                    read.Bytes(3)});
  }
  if (result != SQLITE_DONE) return Error("read");
  return rows;
}

absl::Status Catalogue::PutBan(const BanRow& ban) {
  std::lock_guard lock(mu_);
  Statement put(db_, "INSERT OR REPLACE INTO bans VALUES (?1, ?2)");
  if (!put.ok()) return Error("write");
  put.BindText(1, ban.host);
  put.BindText(2, ban.reason);
  return put.Step() == SQLITE_DONE ? absl::OkStatus() : Error("write");
}

absl::StatusOr<std::vector<BanRow>> Catalogue::ReadBans() {
  std::lock_guard lock(mu_);
  Statement read(db_, "SELECT host, reason FROM bans ORDER BY host");
  if (!read.ok()) return Error("read");
  std::vector<BanRow> bans;
  int result = SQLITE_ROW;
  while ((result = read.Step()) == SQLITE_ROW) bans.push_back({read.Bytes(0), read.Bytes(1)});
  if (result != SQLITE_DONE) return Error("read");
  return bans;
}

absl::Status Catalogue::ForgetBans() { return Execute("DELETE FROM bans"); }

absl::StatusOr<uint64_t> Catalogue::NextIncarnation() {
  std::lock_guard lock(mu_);
  Statement count(db_,
                  "INSERT INTO counters VALUES ('incarnation', 1) ON CONFLICT (name) DO UPDATE "
                  "SET value = value + 1 RETURNING value");
  if (!count.ok() || count.Step() != SQLITE_ROW) return Error("write");
  return static_cast<uint64_t>(count.Integer(0));
}

absl::StatusOr<uint64_t> Catalogue::LastJob() {
  std::lock_guard lock(mu_);
  Statement last(db_, "SELECT value FROM counters WHERE name = 'last_job'");
  if (!last.ok()) return Error("read");
  const int result = last.Step();
  if (result != SQLITE_ROW && result != SQLITE_DONE) return Error("read");
  return result == SQLITE_ROW ? static_cast<uint64_t>(last.Integer(0)) : 0;
}

}  // namespace tessera
