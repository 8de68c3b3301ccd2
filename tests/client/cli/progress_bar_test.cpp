#include "client/cli/progress_bar.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace tessera {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

TEST(ProgressLine, ShowsShareSppErrorAndTimeLeft) {
  v1::Job job;
  job.set_state(v1::JOB_STATE_RUNNING);
  job.mutable_settings()->set_spp(64);
  job.mutable_progress()->set_samples(300);
  job.mutable_progress()->set_samples_total(1000);
  job.mutable_progress()->set_spp(19.2);
  job.mutable_progress()->set_estimated_error(0.0312);
  const std::string line = ProgressLine(job, 75);
  EXPECT_THAT(line, HasSubstr(" 30%"));
  EXPECT_THAT(line, HasSubstr("19.2/64 spp"));
  EXPECT_THAT(line, HasSubstr("error 0.0312"));
  EXPECT_THAT(line, HasSubstr("ETA 1:15"));
  EXPECT_THAT(ProgressLine(job, -1), Not(HasSubstr("ETA")));
}

TEST(ProgressLine, AJobThatEndsByTimeShowsItsShareOfTheTime) {
  v1::Job job;
  job.set_state(v1::JOB_STATE_RUNNING);
  job.mutable_settings()->set_spp(65536);
  job.mutable_settings()->mutable_max_time()->set_seconds(60);
  job.mutable_progress()->set_samples(3);
  job.mutable_progress()->set_samples_total(65536);
  job.mutable_progress()->set_spp(3);
  const std::string line = ProgressLine(job, 15);
  EXPECT_THAT(line, HasSubstr(" 75%"));
  EXPECT_THAT(line, HasSubstr("3.0 spp"));
  EXPECT_THAT(line, Not(HasSubstr("65536")));
}

TEST(ProgressLine, EmptyAndOverfullJobs) {
  v1::Job job;
  EXPECT_THAT(ProgressLine(job, -1), HasSubstr("  0%"));
  job.mutable_progress()->set_samples(3);
  job.mutable_progress()->set_samples_total(2);
  EXPECT_THAT(ProgressLine(job, -1), HasSubstr("100%"));
  job.set_waiting("no worker is connected");
  EXPECT_THAT(ProgressLine(job, -1), HasSubstr("no worker is connected"));
}

TEST(FormatDuration, MinutesAndHours) {
  EXPECT_EQ(FormatDuration(0), "0:00");
  EXPECT_EQ(FormatDuration(59.2), "1:00");
  EXPECT_EQ(FormatDuration(3723), "1:02:03");
  EXPECT_EQ(FormatDuration(-5), "0:00");
}

TEST(FormatBytes, Units) {
  EXPECT_EQ(FormatBytes(999), "999 B");
  EXPECT_EQ(FormatBytes(1500), "1.5 kB");
  EXPECT_EQ(FormatBytes(2500000000), "2.5 GB");
}

}  // namespace
}  // namespace tessera
