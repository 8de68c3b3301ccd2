#include "worker/session/unit_journal.h"

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

namespace tessera {
namespace {

v1::Lease LeaseOf(const std::string& job, int64_t tile) {
  v1::Lease lease;
  lease.set_job(job);
  lease.set_tile_index(tile);
  lease.set_sample_begin(4);
  lease.set_sample_end(8);
  return lease;
}

TEST(UnitJournal, KnowsWhatAnEndedProcessHadInHand) {
  const UnitJournal::Shared journal = UnitJournal::Create();
  ASSERT_NE(journal, nullptr);
  const pid_t child = fork();
  if (child == 0) {
    journal->BeginUnit(0, LeaseOf("jobs/1", 1));
    journal->BeginUnit(1, LeaseOf("jobs/2", 2));
    journal->BeginUnit(2, LeaseOf("jobs/3", 3));
    journal->EndUnit(1);
    journal->BeginBuild("jobs/4");
    _exit(0);
  }
  int status = 0;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  v1::CrashReport report = journal->Report();
  ASSERT_EQ(report.units_size(), 2);
  EXPECT_EQ(report.units(0).job(), "jobs/1");
  EXPECT_EQ(report.units(1).job(), "jobs/3");
  EXPECT_EQ(report.units(1).tile_index(), 3);
  EXPECT_EQ(report.units(1).sample_begin(), 4);
  EXPECT_EQ(report.units(1).sample_end(), 8);
  EXPECT_EQ(report.building_job(), "jobs/4");
  journal->Clear();
  report = journal->Report();
  EXPECT_EQ(report.units_size(), 0);
  EXPECT_EQ(report.building_job(), "");
}

TEST(UnitJournal, LeavesOutWhatHasNoRoom) {
  const UnitJournal::Shared journal = UnitJournal::Create();
  ASSERT_NE(journal, nullptr);
  journal->BeginUnit(UnitJournal::kSlotsMax, LeaseOf("jobs/1", 1));
  journal->EndUnit(UnitJournal::kSlotsMax);
  journal->BeginUnit(0, LeaseOf(std::string(100, 'x'), 1));
  journal->BeginBuild(std::string(100, 'x'));
  const v1::CrashReport report = journal->Report();
  EXPECT_EQ(report.units_size(), 0);
  EXPECT_EQ(report.building_job(), "");
}

}  // namespace
}  // namespace tessera
