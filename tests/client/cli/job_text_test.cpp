#include "client/cli/job_text.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace tessera {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

v1::Worker CrashedWorker() {
  v1::Worker worker;
  worker.set_name("workers/3");
  worker.set_host("blade7");
  worker.set_threads(16);
  worker.set_memory_bytes(8'000'000'000);
  worker.set_version("9.8.7");
  worker.set_crashes(5);
  worker.mutable_last_seen_time()->set_seconds(1'000'000'000);  // 2001-09-09T01:46:40Z
  return worker;
}

// 40 of 100 samples a pixel of 10 pixels in 20 seconds.
v1::Job RunningJob() {
  v1::Job job;
  job.set_name("jobs/2");
  job.set_state(v1::JOB_STATE_RUNNING);
  job.set_owner("ada");
  job.mutable_settings()->set_priority(3);
  v1::JobProgress& progress = *job.mutable_progress();
  progress.set_samples(400);
  progress.set_samples_total(1000);
  progress.set_workers(2);
  progress.mutable_work_time()->set_seconds(20);
  return job;
}

TEST(JobText, AWorkersCrashesAndWhatAPersonOnCallNeedsAreShown) {
  EXPECT_EQ(WorkerJson(CrashedWorker())["crashes"], 5);
  EXPECT_THAT(WorkerRowHeading(), AllOf(HasSubstr("CRASHES"), HasSubstr("LAST SEEN"),
                                        HasSubstr("MEMORY"), HasSubstr("VERSION")));
  EXPECT_THAT(WorkerRow(CrashedWorker()),
              AllOf(HasSubstr(" 5 "), HasSubstr("01:46:40Z"), HasSubstr("8.0 GB"),
                    HasSubstr("9.8.7")));
}

TEST(JobText, AJobSaysWhoseItIsHowFastAndHowLongStill) {
  const nlohmann::ordered_json json = JobJson(RunningJob());
  EXPECT_EQ(json["owner"], "ada");
  EXPECT_EQ(json["work_seconds"], 20);
  EXPECT_EQ(json["samples_per_second"], 20);
  EXPECT_EQ(json["seconds_left"], 30);
  EXPECT_THAT(JobDetails(RunningJob()),
              AllOf(HasSubstr("owner        ada\n"), HasSubstr("priority     3\n"),
                    HasSubstr("workers      2\n"), HasSubstr("running      20 s\n"),
                    HasSubstr("rate         20 samples/s\n"), HasSubstr("left         30 s")));
}

TEST(JobText, NoEndIsForetoldWhereNothingRunsOrIsKnown) {
  v1::Job job = RunningJob();
  job.set_state(v1::JOB_STATE_PAUSED);
  EXPECT_TRUE(JobJson(job)["seconds_left"].is_null());
  job = RunningJob();
  job.mutable_progress()->set_samples(0);
  EXPECT_TRUE(JobJson(job)["seconds_left"].is_null());
  EXPECT_THAT(JobDetails(job), Not(HasSubstr("left ")));
}

}  // namespace
}  // namespace tessera
