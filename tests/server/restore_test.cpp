// What a server finds in its data folder after it was killed, at any moment and with any damage.
#include "server/restore.h"

#include <filesystem>
#include <fstream>

#include <gtest/gtest.h>

#include "server/job_saver.h"
#include "server/store/catalogue.h"
#include "server/store/film_store.h"
#include "tests/server/simulated_farm.h"

namespace tessera {
namespace {

constexpr int64_t kPixels = 190;

CoordinatorConfig StoringConfig() {
  CoordinatorConfig config = SmallConfig();
  config.stores_records = true;
  return config;
}

class NoEffects : public EffectSink {
 public:
  void Apply(const Effect&) override {}
};

// A server's data folder and its coordinator, whose effects the test carries out itself.
class ServerRun {
 public:
  explicit ServerRun(const std::string& dir)
      : catalogue(*Catalogue::Open(dir + "/jobs.sqlite")),
        films(*FilmStore::Open(dir + "/films")),
        assets(*AssetStore::Open(dir + "/assets", 0)),
        host(StoringConfig(), effects),
        saver(std::make_unique<JobSaver>(catalogue.get(), films.get(), assets.get())) {}

  absl::Status Restore() {
    return RestoreJobs(*catalogue, *films, *assets, SmallConfig().defaults, host);
  }
  v1::Job Job(JobId id) const {
    return *host.Read([&](const Coordinator& c) { return c.GetJob(id); });
  }
  // Once its end, if it has one, is on disk.
  v1::Job SavedJob(JobId id) {
    saver->Attach(&host);
    saver->Save(id, false);
    EXPECT_TRUE(saver->WriteDue());
    return Job(id);
  }
  bool Has(JobId id) const {
    return host.Read([&](const Coordinator& c) { return c.GetJob(id).ok(); });
  }

  NoEffects effects;
  std::unique_ptr<Catalogue> catalogue;
  std::unique_ptr<FilmStore> films;
  std::unique_ptr<AssetStore> assets;
  CoordinatorHost host;
  std::unique_ptr<JobSaver> saver;
};

class RestoreTest : public testing::Test {
 protected:
  void SetUp() override {
    dir_ = testing::TempDir() + "/restore-" + std::to_string(::getpid());
    std::filesystem::remove_all(dir_);
    std::filesystem::create_directories(dir_);
    run_ = std::make_unique<ServerRun>(dir_);
    const std::string scene = "a scene";
    settings_.mutable_assets(0)->set_sha256(ToBytes(Sha256Of(scene)));
    ASSERT_TRUE(run_->assets->Append(Sha256Of(scene), 7, 0, scene).ok());
  }
  void TearDown() override { std::filesystem::remove_all(dir_); }

  // A row as a server has left it, 8 of 16 samples rendered.
  v1::Job Record(JobId id, v1::JobState state = v1::JOB_STATE_RUNNING) {
    v1::Job job;
    job.set_name(JobName(id));
    *job.mutable_settings() = *CompleteSettings(settings_, SmallConfig().defaults);
    job.set_state(state);
    job.set_version(SmallConfig().version);
    job.mutable_progress()->set_samples(8 * kPixels);
    job.mutable_progress()->set_rays(999999);
    return job;
  }
  void PutRow(JobId id, const std::string& record) {
    ASSERT_TRUE(run_->catalogue->Put({id, "", record}).ok());
  }
  void PutFilm(JobId id, int64_t spp) {
    const TileGrid grid(RegionOf(settings_), settings_.tile_size());
    const Film film = SyntheticFilm(0, grid, spp, FeatureEndOf(settings_.feature_spp()));
    ASSERT_TRUE(run_->films
                    ->Save(id, grid.num_tiles(),
                           [&](int64_t tile) {
                             return FilmStore::Tile{film.Nodes(tile), {.rays = 5}};
                           })
                    .ok());
  }
  std::string FilmPath(JobId id) const { return dir_ + "/films/" + std::to_string(id) + ".film"; }

  std::string dir_;
  v1::JobSettings settings_ = SmallSettings(16);
  std::unique_ptr<ServerRun> run_;
};

TEST_F(RestoreTest, FiguresAreOfTheFilmsMoment) {
  PutRow(1, Record(1).SerializeAsString());
  PutFilm(1, 4);
  ASSERT_TRUE(run_->Restore().ok());
  const v1::JobProgress progress = run_->Job(1).progress();
  EXPECT_EQ(progress.samples(), 4 * kPixels);
  EXPECT_EQ(progress.rays(), 6 * 5) << "of the film's six tiles, not the record's";
}

TEST_F(RestoreTest, DamageCostsItsOwnJobOnly) {
  PutRow(1, "this is no record");
  PutRow(2, Record(3).SerializeAsString());  // another job's
  v1::Job bad = Record(4);
  bad.mutable_settings()->set_tile_size(0);
  bad.mutable_settings()->set_width(-5);
  PutRow(4, bad.SerializeAsString());
  bad = Record(5);
  bad.mutable_settings()->mutable_assets(0)->set_sha256("short");
  PutRow(5, bad.SerializeAsString());
  bad = Record(6);
  bad.mutable_settings()->set_denoiser("magic");
  PutRow(6, bad.SerializeAsString());
  bad = Record(7);
  bad.set_state(static_cast<v1::JobState>(77));
  PutRow(7, bad.SerializeAsString());
  bad = Record(8);
  bad.mutable_settings()->mutable_assets(0)->set_sha256(std::string(32, 'q'));
  PutRow(8, bad.SerializeAsString());
  bad.set_name("jobs/9");
  bad.set_state(v1::JOB_STATE_DONE);
  PutRow(9, bad.SerializeAsString());
  PutRow(10, Record(10).SerializeAsString());
  PutFilm(10, 8);
  PutRow(11, Record(11).SerializeAsString());
  PutFilm(11, 8);
  std::filesystem::resize_file(FilmPath(11), 500);
  PutFilm(4, 8);
  PutFilm(12, 8);

  ASSERT_TRUE(run_->Restore().ok());
  for (const JobId id : {1u, 2u, 4u, 5u, 6u, 7u}) EXPECT_FALSE(run_->Has(id)) << id;
  EXPECT_EQ(run_->SavedJob(8).state(), v1::JOB_STATE_FAILED) << "its assets are lost";
  EXPECT_NE(run_->Job(8).error().find("submit"), std::string::npos);
  EXPECT_EQ(run_->Job(9).state(), v1::JOB_STATE_DONE) << "it needs them no more";
  EXPECT_EQ(run_->Job(10).progress().samples(), 8 * kPixels);
  EXPECT_EQ(run_->Job(11).progress().samples(), 0) << "rendered again";
  EXPECT_EQ(run_->Job(11).state(), v1::JOB_STATE_QUEUED);
  EXPECT_TRUE(std::filesystem::exists(FilmPath(4))) << "its row can still be mended";
  EXPECT_FALSE(std::filesystem::exists(FilmPath(12))) << "it has no row";
}

// The record may be written while the film of that moment is not.
TEST_F(RestoreTest, AJobThatWasFinishingWithALaterFilmRendersTheRest) {
  v1::Job record = Record(1, v1::JOB_STATE_FINISHING);
  record.mutable_progress()->set_samples(16 * kPixels);
  record.set_stop_reason(v1::STOP_REASON_SPP);
  PutRow(1, record.SerializeAsString());
  PutFilm(1, 8);
  record.set_name("jobs/2");
  PutRow(2, record.SerializeAsString());
  PutFilm(2, 16);
  record.set_name("jobs/3");
  record.set_stop_reason(v1::STOP_REASON_CANCELLED);
  PutRow(3, record.SerializeAsString());
  PutFilm(3, 8);
  record.set_name("jobs/4");
  PutRow(4, record.SerializeAsString());  // no film at all
  ASSERT_TRUE(run_->Restore().ok());
  EXPECT_EQ(run_->Job(1).state(), v1::JOB_STATE_QUEUED);
  EXPECT_EQ(run_->Job(2).state(), v1::JOB_STATE_FINISHING);
  EXPECT_EQ(run_->Job(3).state(), v1::JOB_STATE_FINISHING) << "a cancelled job goes on no more";
  EXPECT_EQ(run_->SavedJob(4).state(), v1::JOB_STATE_CANCELLED);
}

TEST_F(RestoreTest, AnotherVersionsSamplesLeaveTheDisk) {
  v1::Job record = Record(1);
  record.set_version("1.2.2");
  PutRow(1, record.SerializeAsString());
  PutFilm(1, 8);
  record.set_name("jobs/2");
  record.set_state(v1::JOB_STATE_DONE);
  PutRow(2, record.SerializeAsString());
  PutFilm(2, 16);
  ASSERT_TRUE(run_->Restore().ok());
  EXPECT_EQ(run_->Job(1).version(), SmallConfig().version);
  EXPECT_EQ(run_->Job(1).progress().samples(), 0);
  EXPECT_FALSE(std::filesystem::exists(FilmPath(1))) << "the next start would take it for its own";
  EXPECT_EQ(run_->Job(2).version(), "1.2.2");
  EXPECT_TRUE(std::filesystem::exists(FilmPath(2)));
}

TEST_F(RestoreTest, MaxTimeGoesOnWhereItWas) {
  settings_.set_spp(1024);
  settings_.mutable_max_time()->set_seconds(10);
  v1::Job record = Record(1);
  record.mutable_progress()->mutable_work_time()->set_seconds(11);
  PutRow(1, record.SerializeAsString());
  PutFilm(1, 8);
  record.set_name("jobs/2");
  record.mutable_progress()->mutable_work_time()->set_seconds(int64_t{1} << 62);  // damaged
  PutRow(2, record.SerializeAsString());
  PutFilm(2, 8);
  ASSERT_TRUE(run_->Restore().ok());
  EXPECT_EQ(run_->Job(1).state(), v1::JOB_STATE_FINISHING) << "its time was over";
  EXPECT_EQ(run_->Job(1).stop_reason(), v1::STOP_REASON_MAX_TIME);
  EXPECT_EQ(run_->Job(2).state(), v1::JOB_STATE_QUEUED);
}

class SaverTest : public RestoreTest {
 protected:
  void SetUp() override {
    RestoreTest::SetUp();
    run_->saver->Start(&run_->host);
    job_ = run_->host.Post(CreateJobEvent{.settings = settings_}).job;
    ASSERT_TRUE(run_->saver->SaveNow(job_).ok());
    const SessionId session = 1;
    SimulatedFarm farm;
    run_->host.Post(WorkerConnectedEvent{session, farm.MakeHello("host", 2)});
  }
  // Merges all samples of the job's first pass over the frame: [0, 1) of each tile.
  void Merge() {
    const TileGrid grid(RegionOf(settings_), settings_.tile_size());
    for (int64_t tile = 0; tile < grid.num_tiles(); ++tile) {
      for (const int64_t size : {1, 2, 4, 8, 16}) {
        DeltaEvent event{.session = 1};
        event.delta.set_job(JobName(job_));
        event.delta.set_tile_index(tile);
        event.delta.set_rays(1000 + tile);
        event.tile = SyntheticTile(0, grid.WindowOf(tile), {0, size},
                                   FeatureEndOf(settings_.feature_spp()));
        if (run_->host.Post(std::move(event)).status.ok()) break;
      }
    }
  }
  // A new server on what is on disk, as if this one were killed now.
  v1::Job AfterKill() {
    const std::string copy = dir_ + "-copy";
    std::filesystem::remove_all(copy);
    std::filesystem::copy(dir_, copy, std::filesystem::copy_options::recursive);
    ServerRun next(copy);
    EXPECT_TRUE(next.Restore().ok());
    const v1::Job job = next.Has(job_) ? next.Job(job_) : v1::Job();
    std::filesystem::remove_all(copy);
    return job;
  }

  JobId job_ = 0;
};

TEST_F(SaverTest, WhatCouldNotBeWrittenIsWrittenLater) {
  Merge();
  const v1::Job merged = run_->Job(job_);
  ASSERT_GT(merged.progress().samples(), 0);
  // No film can be written in the place of this folder.
  std::filesystem::create_directories(FilmPath(job_) + "/full");
  run_->saver->Save(job_, true);
  EXPECT_EQ(AfterKill().progress().samples(), 0);
  std::filesystem::remove_all(FilmPath(job_));
  run_->saver->Stop();
  const v1::Job restored = AfterKill();
  EXPECT_EQ(restored.progress().samples(), merged.progress().samples());
  EXPECT_EQ(restored.progress().rays(), merged.progress().rays());
}

TEST_F(SaverTest, AJobThatWasDeletedStaysDeleted) {
  Merge();
  ASSERT_TRUE(run_->host.Post(JobCommandEvent{JobCommand::kDelete, job_, ""}).status.ok());
  ASSERT_TRUE(run_->saver->RemoveNow(job_).ok());
  EXPECT_EQ(AfterKill().name(), "") << "once that was acknowledged";
  run_->saver->Save(job_, true);
  run_->saver->Stop();
  EXPECT_EQ(AfterKill().name(), "");
}

TEST_F(SaverTest, APauseSurvivesAtOnce) {
  Merge();
  ASSERT_TRUE(run_->host.Post(JobCommandEvent{JobCommand::kPause, job_, ""}).status.ok());
  ASSERT_TRUE(run_->saver->SaveNow(job_).ok());
  EXPECT_EQ(AfterKill().state(), v1::JOB_STATE_PAUSED);
}

// Its end waits for its film, which this run never writes.
TEST_F(SaverTest, AnEndIsNotWrittenBeforeTheFilm) {
  Merge();
  ASSERT_TRUE(run_->host.Post(JobCommandEvent{JobCommand::kCancel, job_, ""}).status.ok());
  run_->host.Post(JobFinishedEvent{job_, {}});
  ASSERT_TRUE(run_->saver->SaveNow(job_).ok());
  EXPECT_EQ(AfterKill().digest(), "");
  EXPECT_EQ(run_->Job(job_).state(), v1::JOB_STATE_FINISHING) << "what a kill would take back";
  EXPECT_FALSE(run_->Job(job_).has_end_time());
  EXPECT_EQ(run_->Job(job_).digest(), "");
  const uint64_t revision = run_->Job(job_).revision().counter();
  run_->saver->Save(job_, true);
  run_->saver->Stop();
  EXPECT_EQ(AfterKill().state(), v1::JOB_STATE_CANCELLED);
  EXPECT_EQ(run_->Job(job_).state(), v1::JOB_STATE_CANCELLED);
  EXPECT_TRUE(run_->Job(job_).has_end_time());
  EXPECT_EQ(run_->Job(job_).digest(), AfterKill().digest());
  EXPECT_GT(run_->Job(job_).revision().counter(), revision) << "watches are told";
}

// Its film is still to be written, but that it was cancelled must not be forgotten meanwhile.
TEST_F(RestoreTest, AnAcknowledgedCancellationIsOnDiskBeforeTheFilm) {
  run_->saver->Attach(&run_->host);
  const JobId job = run_->host.Post(CreateJobEvent{.settings = settings_}).job;
  ASSERT_TRUE(run_->saver->SaveNow(job).ok());
  SimulatedFarm farm;  // makes a delta of the job's first lease
  const JobId same = farm.Create(settings_);
  const SessionId session = farm.Connect();
  DeltaEvent delta = farm.Render(session, farm.workers[session].leases.front());
  delta.delta.set_job(JobName(job));
  ASSERT_EQ(same, job);
  run_->host.Post(WorkerConnectedEvent{session, farm.MakeHello("host", 2)});
  ASSERT_TRUE(run_->host.Post(std::move(delta)).status.ok());
  ASSERT_TRUE(run_->host.Post(JobCommandEvent{JobCommand::kCancel, job, ""}).status.ok());
  run_->host.Post(JobFinishedEvent{job, {}});
  ASSERT_TRUE(run_->saver->SaveNow(job).ok());
  v1::Job row;
  ASSERT_TRUE(row.ParseFromString(run_->catalogue->ReadAll()->at(0).record));
  EXPECT_EQ(row.stop_reason(), v1::STOP_REASON_CANCELLED);
  EXPECT_EQ(row.state(), v1::JOB_STATE_FINISHING) << "its film is not there yet";

  // And what says that all is over stays, however often the call is repeated.
  while (run_->saver->WriteDue()) {
  }
  run_->saver->Save(job, true);
  ASSERT_TRUE(run_->saver->WriteDue());
  ASSERT_TRUE(run_->saver->SaveNow(job).ok());
  ASSERT_TRUE(row.ParseFromString(run_->catalogue->ReadAll()->at(0).record));
  EXPECT_EQ(row.state(), v1::JOB_STATE_CANCELLED);
}

TEST_F(RestoreTest, BansComeBack) {
  run_->saver->Attach(&run_->host);
  run_->saver->SaveBan("liar", "it lied");
  while (run_->saver->WriteDue()) {
  }
  run_ = std::make_unique<ServerRun>(dir_);
  ASSERT_TRUE(run_->Restore().ok());
  EXPECT_TRUE(run_->host.Read([](const Coordinator& c) { return c.IsBanned("liar"); }));
  EXPECT_FALSE(run_->host.Read([](const Coordinator& c) { return c.IsBanned("honest"); }));
}

// The saver takes down who has rendered what and what is suspected; the restorer brings it back.
TEST_F(RestoreTest, ContributionsAndSuspectsComeBack) {
  PutRow(1, Record(1).SerializeAsString());
  PutFilm(1, 4);
  ASSERT_TRUE(run_->Restore().ok());
  v1::Contributions contributions;
  contributions.add_hosts()->set_host("a");
  contributions.mutable_hosts(0)->add_tiles(1);
  contributions.mutable_hosts(0)->add_sample_begins(0);
  contributions.mutable_hosts(0)->add_sample_ends(4);
  v1::Suspects suspects;
  suspects.add_units()->set_tile(2);
  suspects.mutable_units(0)->set_sample_begin(4);
  suspects.mutable_units(0)->set_sample_end(6);
  RestoreJobEvent event;
  event.job = Record(2);
  event.suspects = suspects;
  event.contributions = contributions;
  ASSERT_TRUE(run_->host.Post(std::move(event)).status.ok());
  run_->saver->Attach(&run_->host);
  run_->saver->Save(2, true);
  while (run_->saver->WriteDue()) {
  }
  run_ = std::make_unique<ServerRun>(dir_);
  ASSERT_TRUE(run_->Restore().ok());
  run_->host.Read([&](const Coordinator& c) {
    EXPECT_EQ(c.ContributionsOf(2).SerializeAsString(), contributions.SerializeAsString());
    EXPECT_EQ(c.SuspectsOf(2).SerializeAsString(), suspects.SerializeAsString());
  });
}

// Rows that find no room when the test says so.
class FullRows : public RowStorage {
 public:
  absl::Status Put(const CatalogueRow&) override { return Room(); }
  absl::Status Remove(uint64_t) override { return Room(); }
  absl::StatusOr<std::vector<CatalogueRow>> ReadAll() override {
    return std::vector<CatalogueRow>();
  }
  absl::Status PutBan(const BanRow&) override { return Room(); }
  absl::StatusOr<std::vector<BanRow>> ReadBans() override { return std::vector<BanRow>(); }
  bool full = false;

 private:
  absl::Status Room() const {
    return full ? absl::ResourceExhaustedError("no space left on device") : absl::OkStatus();
  }
};

TEST_F(RestoreTest, AFullDiskStopsJobsUntilWhatFailedIsWritten) {
  FullRows rows;
  JobSaver::Clock::time_point now{};
  JobSaver saver(&rows, run_->films.get(), run_->assets.get(), [&] { return now; });
  CoordinatorHost& host = run_->host;
  saver.Attach(&host);
  const auto waiting = [&](JobId job) {
    return host.Read([&](const Coordinator& c) { return c.GetJob(job)->waiting(); });
  };
  CreateJobEvent create;
  create.settings = settings_;
  const JobId job = host.Post(std::move(create)).job;
  rows.full = true;
  saver.Save(job, false);
  EXPECT_TRUE(saver.WriteDue());
  EXPECT_NE(waiting(job).find("disk is full"), std::string::npos) << waiting(job);
  EXPECT_FALSE(saver.WriteDue()) << "not before some seconds have passed";
  now += std::chrono::seconds(6);
  EXPECT_TRUE(saver.WriteDue());
  EXPECT_NE(waiting(job).find("disk is full"), std::string::npos);
  rows.full = false;
  now += std::chrono::seconds(6);
  EXPECT_TRUE(saver.WriteDue());
  EXPECT_EQ(waiting(job).find("disk is full"), std::string::npos);
}

// A client must not wait for an end without a word.
TEST_F(RestoreTest, AnEndThatCannotBeWrittenIsShownLaterAndSaysWhy) {
  FullRows rows;
  JobSaver::Clock::time_point now{};
  JobSaver saver(&rows, run_->films.get(), run_->assets.get(), [&] { return now; });
  saver.Attach(&run_->host);
  const JobId job = run_->host.Post(CreateJobEvent{.settings = settings_}).job;
  rows.full = true;
  ASSERT_TRUE(run_->host.Post(JobCommandEvent{JobCommand::kCancel, job, ""}).status.ok());
  EXPECT_EQ(run_->Job(job).state(), v1::JOB_STATE_FINISHING);
  const uint64_t revision = run_->Job(job).revision().counter();
  saver.Save(job, false);
  EXPECT_TRUE(saver.WriteDue());
  EXPECT_EQ(run_->Job(job).state(), v1::JOB_STATE_FINISHING);
  EXPECT_NE(run_->Job(job).waiting().find("no space left"), std::string::npos)
      << run_->Job(job).waiting();
  EXPECT_GT(run_->Job(job).revision().counter(), revision) << "watches are told";
  rows.full = false;
  now += std::chrono::seconds(6);
  EXPECT_TRUE(saver.WriteDue());
  EXPECT_EQ(run_->Job(job).state(), v1::JOB_STATE_CANCELLED);
  EXPECT_EQ(run_->Job(job).waiting(), "");
}

TEST_F(RestoreTest, ADeletedJobDoesNotKeepTheDiskFull) {
  FullRows rows;
  JobSaver::Clock::time_point now{};
  JobSaver saver(&rows, run_->films.get(), run_->assets.get(), [&] { return now; });
  CoordinatorHost& host = run_->host;
  saver.Attach(&host);
  CreateJobEvent create;
  create.settings = settings_;
  const JobId job = host.Post(std::move(create)).job;
  rows.full = true;
  saver.Save(job, false);
  EXPECT_TRUE(saver.WriteDue());
  EXPECT_TRUE(host.Read([](const Coordinator& c) { return c.IsDiskFull(); }));
  host.Post(JobCommandEvent{JobCommand::kDelete, job, ""});
  now += std::chrono::seconds(6);
  EXPECT_TRUE(saver.WriteDue());
  EXPECT_FALSE(host.Read([](const Coordinator& c) { return c.IsDiskFull(); }));
}

}  // namespace
}  // namespace tessera
