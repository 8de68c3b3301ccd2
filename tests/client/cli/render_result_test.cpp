#include "client/cli/render_result.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace tessera {
namespace {

using ::testing::ElementsAre;
using std::chrono::seconds;

v1::Job JobIn(v1::JobState state) {
  v1::Job job;
  job.set_state(state);
  job.mutable_scene()->set_load_seconds(2);
  job.mutable_start_time()->set_seconds(100);
  job.mutable_end_time()->set_seconds(111);
  return job;
}

TEST(RenderClock, SplitsTheTime) {
  const RenderClock::TimePoint start;
  RenderClock clock(start);
  clock.OnChange(JobIn(v1::JOB_STATE_RUNNING), start + seconds(9));
  clock.OnChange(JobIn(v1::JOB_STATE_FINISHING), start + seconds(13));
  clock.OnChange(JobIn(v1::JOB_STATE_DONE), start + seconds(14));
  const RenderSeconds parts = clock.Seconds(JobIn(v1::JOB_STATE_DONE), start + seconds(16));
  EXPECT_EQ(parts.load, 2);
  EXPECT_EQ(parts.render, 11 - 2 - 1);  // less loading, less filtering
  EXPECT_EQ(parts.filter, 3);
  EXPECT_EQ(parts.total, 16);
}

TEST(RenderClock, AJobThatNeverBegan) {
  const RenderClock::TimePoint start;
  RenderClock clock(start);
  v1::Job job;
  job.set_state(v1::JOB_STATE_CANCELLED);
  clock.OnChange(job, start + seconds(1));
  EXPECT_EQ(clock.Seconds(job, start + seconds(2)).render, 0);
}

TEST(ResultJson, HasExactlyTheStableFields) {
  RenderResult result;
  result.job.mutable_settings()->set_width(4);
  result.job.set_digest("\x01\xff");
  result.job.set_stop_reason(v1::STOP_REASON_TARGET_ERROR);
  result.job.mutable_settings()->set_target_error(0.5);
  result.outputs = {"a.exr"};
  const nlohmann::ordered_json json = ResultJson(result);
  std::vector<std::string> keys;
  for (const auto& [key, value] : json.items()) keys.push_back(key);
  EXPECT_THAT(keys, ElementsAre("digest", "width", "height", "spp", "samples", "rays", "non_finite",
                                "seconds", "error", "stopped_by", "bytes", "outputs"));
  EXPECT_EQ(json["digest"], "01ff");
  EXPECT_EQ(json["stopped_by"], "target_error");
  EXPECT_TRUE(json["error"]["rel_rmse"].is_null());  // unknown
  EXPECT_EQ(json["error"].size(), 2u);
  EXPECT_EQ(json["error"]["promised"], 0.5);
  EXPECT_TRUE(json["seconds"].contains("filter"));
  EXPECT_TRUE(json["bytes"].contains("deltas"));
}

TEST(ResultJson, SaysMoreOnlyOfWhatWasAskedFor) {
  RenderResult result;
  result.job.mutable_settings()->set_target_tile_error(0.75);
  result.job.mutable_progress()->set_worst_tile_error(0.625);
  result.job.mutable_settings()->set_auto_depth(true);
  EXPECT_TRUE(ResultJson(result)["max_depth"].is_null());  // not found yet
  result.job.set_max_depth(5);
  const nlohmann::ordered_json json = ResultJson(result);
  EXPECT_EQ(json["error"]["worst_tile"], 0.625);
  EXPECT_EQ(json["error"]["promised_tile"], 0.75);
  EXPECT_EQ(json["max_depth"], 5);
}

}  // namespace
}  // namespace tessera
