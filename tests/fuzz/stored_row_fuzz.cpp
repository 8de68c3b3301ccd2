// What the catalogue says of a job when a server starts. Input: its record (tessera.v1.Job), its
// suspects, and who has rendered what, each behind its length in two bytes. The server starts
// whatever is there, and what it takes can be rendered, steered and deleted.
#include <google/protobuf/stubs/logging.h>

#include <cstdlib>

#include "absl/strings/str_cat.h"
#include "server/restore.h"
#include "tests/fuzz/fuzz_target.h"
#include "tests/server/simulated_farm.h"

namespace tessera {
namespace {

constexpr int64_t kPixelsMax = 1 << 16;  // above, no film is made: a fuzzer's memory is small

std::string Next(std::string_view* input) {
  if (input->size() < 2) return "";
  const auto* const bytes = reinterpret_cast<const uint8_t*>(input->data());
  const size_t length = std::min<size_t>(bytes[0] + 256u * bytes[1], input->size() - 2);
  std::string part(input->substr(2, length));
  input->remove_prefix(2 + length);
  return part;
}

void Append(const std::string& part, std::string* out) {
  out->push_back(static_cast<char>(part.size() & 255));
  out->push_back(static_cast<char>(part.size() >> 8));
  out->append(part);
}

// A catalogue of one row.
class OneRow : public RowStorage {
 public:
  explicit OneRow(CatalogueRow row) : row_(std::move(row)) {}
  absl::Status Put(const CatalogueRow&) override { return absl::OkStatus(); }
  absl::Status Remove(uint64_t) override { return absl::OkStatus(); }
  absl::StatusOr<std::vector<CatalogueRow>> ReadAll() override { return {{row_}}; }
  absl::Status PutBan(const BanRow&) override { return absl::OkStatus(); }
  absl::StatusOr<std::vector<BanRow>> ReadBans() override {
    return {{BanRow{"liar", "it returned wrong bits"}}};
  }

 private:
  const CatalogueRow row_;
};

// Films of four samples of every job.
class FourSamples : public FilmStorage {
 public:
  explicit FourSamples(std::string contributions) : contributions_(std::move(contributions)) {}
  absl::Status Save(uint64_t, int64_t, const TileSource&,
                    const ContributionSource&) const override {
    return absl::OkStatus();
  }
  absl::StatusOr<StoredFilm> Load(uint64_t, const TileGrid& grid,
                                  int64_t feature_end) const override {
    StoredFilm stored;
    stored.film = std::make_shared<Film>(SyntheticFilm(1, grid, 4, feature_end));
    stored.costs.resize(static_cast<size_t>(grid.num_tiles()));
    stored.contributions = contributions_;
    return stored;
  }
  void Remove(uint64_t) const override {}
  int RemoveAllBut(const std::set<uint64_t>&) const override { return 0; }

 private:
  const std::string contributions_;
};

class NoEffects : public EffectSink {
 public:
  void Apply(const Effect&) override {}
};

v1::Job SmallJob(v1::JobState state) {
  v1::Job job;
  job.set_name("jobs/1");
  job.set_state(state);
  job.set_version(SmallConfig().version);
  job.set_arithmetic(kArithmetic);
  *job.mutable_settings() = SmallSettings(16);
  job.mutable_settings()->set_sampling(v1::SAMPLING_UNIFORM);
  job.mutable_progress()->set_samples(4 * 190);
  job.mutable_progress()->set_committed_spp(4);
  job.mutable_progress()->mutable_work_time()->set_seconds(3);
  return job;
}

std::string Seed(const v1::Job& job) {
  v1::Suspects suspects;
  v1::SuspectUnit& unit = *suspects.add_units();
  unit.set_tile(1);
  unit.set_sample_begin(4);
  unit.set_sample_end(8);
  unit.set_crashes_alone(1);
  unit.add_processes()->set_host("one");
  v1::Contributions who;
  v1::Contribution& host = *who.add_hosts();
  host.set_host("liar");
  host.add_tiles(1);
  host.add_sample_begins(0);
  host.add_sample_ends(4);
  std::string seed;
  Append(job.SerializeAsString(), &seed);
  Append(suspects.SerializeAsString(), &seed);
  Append(who.SerializeAsString(), &seed);
  return seed;
}

// Returns whether the job is there afterwards.
bool Restore(std::string_view input) {
  CatalogueRow row{.job = 1, .request_id = "once", .record = Next(&input)};
  row.suspects = Next(&input);
  v1::Job record;
  if (record.ParseFromString(row.record) &&
      int64_t{record.settings().width()} * record.settings().height() > kPixelsMax) {
    return false;
  }
  OneRow rows(std::move(row));
  const FourSamples films(Next(&input));
  const std::unique_ptr<AssetStore> assets = *AssetStore::Open("", 0);
  NoEffects sink;
  CoordinatorHost host(SmallConfig(), sink, [] { return Instant{1000, 1700000000000}; });
  if (!RestoreJobs(rows, films, *assets, SmallConfig().defaults, host).ok()) std::abort();
  const auto job = host.Read([](const Coordinator& c) { return c.GetJob(1); });
  if (!job.ok()) return false;
  v1::Hello hello = SimulatedFarm().MakeHello("honest", 2);
  host.Post(WorkerConnectedEvent{1, std::move(hello)});
  host.Post(TickEvent{});
  host.Post(JobCommandEvent{JobCommand::kPause, 1, ""});
  host.Post(JobCommandEvent{JobCommand::kResume, 1, ""});
  host.Post(WorkerGoneEvent{1});
  if (!host.Post(JobCommandEvent{JobCommand::kDelete, 1, ""}).status.ok()) std::abort();
  return true;
}

}  // namespace

bool IsTaken(std::string_view input) { return Restore(input); }

void FuzzOne(std::string_view input) { (void)Restore(input); }

std::vector<std::string> FuzzSeeds() {
  google::protobuf::SetLogHandler(nullptr);  // what is no UTF-8 is no news here
  v1::Job adaptive = SmallJob(v1::JOB_STATE_PAUSED);
  adaptive.mutable_settings()->set_target_error(0.05);
  adaptive.mutable_settings()->set_sampling(v1::SAMPLING_ADAPTIVE);
  v1::Job done = SmallJob(v1::JOB_STATE_DONE);
  done.set_digest(std::string(32, 'd'));
  done.mutable_end_time()->set_seconds(1700000000);
  return {Seed(SmallJob(v1::JOB_STATE_RUNNING)), Seed(SmallJob(v1::JOB_STATE_FINISHING)),
          Seed(adaptive), Seed(done)};
}

}  // namespace tessera
