// Jobs that sample adaptively: when they stop. What they decide: sample_plan_test.cpp; after a
// restart: coordinator_restore_test.cpp.
#include <algorithm>
#include <cmath>

#include "gtest/gtest.h"
#include "server/coordinator/sample_counts.h"
#include "server/coordinator/sample_plan.h"
#include "tests/server/simulated_farm.h"

namespace tessera {
namespace {

constexpr int kWidth = 80, kHeight = 48;  // 15 cells

v1::JobSettings AdaptiveSettings() {
  v1::JobSettings settings = SmallSettings(1024);
  settings.set_width(kWidth);
  settings.set_height(kHeight);
  settings.set_sampling(v1::SAMPLING_ADAPTIVE);
  return settings;
}

// A farm whose errors fall as 1/n, and where a sample of the first cell leaves 100 times those of
// the others.
void JudgePictures(SimulatedFarm* farm) {
  farm->cell_errors = [farm](const Film& film) {
    std::vector<CellError> errors;
    double sum = 0;
    for (int64_t tile = 0; tile < film.grid().num_tiles(); ++tile) {
      const auto area = static_cast<double>(film.grid().WindowOf(tile).area());
      const double error =
          (tile == 0 ? 100 : 1) * 3 * area / static_cast<double>(film.CommittedEnd(tile));
      errors.push_back({error, error});
      sum += error;
    }
    farm->estimated_error = std::sqrt(sum / (3 * kWidth * kHeight));
    return errors;
  };
}

struct Ended {
  v1::Job job;
  std::vector<int64_t> samples;  // by cell
};

Ended RunJob(const v1::JobSettings& settings) {
  SimulatedFarm farm;
  JudgePictures(&farm);
  const JobId job = farm.Create(settings);
  farm.Connect();
  farm.RunAll();
  Ended ended{.job = farm.Job(job), .samples = {}};
  if (ended.job.has_sample_counts()) ended.samples = ExpandCounts(ended.job.sample_counts());
  return ended;
}

TEST(CoordinatorPlan, ATargetOfCellsIsMetByEveryCell) {
  v1::JobSettings settings = AdaptiveSettings();
  settings.set_target_tile_error(0.4);
  const Ended ended = RunJob(settings);
  EXPECT_EQ(ended.job.stop_reason(), v1::STOP_REASON_TARGET_ERROR);
  EXPECT_GT(ended.job.progress().worst_tile_error(), 0.2);
  EXPECT_LE(ended.job.progress().worst_tile_error(), 0.4);
  ASSERT_EQ(ended.samples.size(), 15u);
  EXPECT_GT(ended.samples[0], 64);
  EXPECT_EQ(ended.samples[14], kPilotSpp) << "it met the target with the pilot";
}

TEST(CoordinatorPlan, BothTargetsAreMet) {
  v1::JobSettings settings = AdaptiveSettings();
  settings.set_target_error(0.3);
  const Ended image = RunJob(settings);
  EXPECT_LE(image.job.progress().estimated_error(), 0.3);
  EXPECT_GT(image.job.progress().worst_tile_error(), 0.35);
  settings.set_target_tile_error(0.35);
  const Ended both = RunJob(settings);
  EXPECT_EQ(both.job.stop_reason(), v1::STOP_REASON_TARGET_ERROR);
  EXPECT_LE(both.job.progress().estimated_error(), 0.3);
  EXPECT_LE(both.job.progress().worst_tile_error(), 0.35);
  settings.set_target_error(0.1);
  const Ended finer = RunJob(settings);
  EXPECT_LE(finer.job.progress().estimated_error(), 0.1);
  EXPECT_GT(finer.job.progress().samples(), both.job.progress().samples());
}

TEST(CoordinatorPlan, StopsAtTheMostSamplesShortOfItsTarget) {
  v1::JobSettings settings = AdaptiveSettings();
  settings.set_spp(32);
  settings.set_target_tile_error(1e-3);
  const Ended ended = RunJob(settings);
  EXPECT_EQ(ended.job.stop_reason(), v1::STOP_REASON_SPP);
  EXPECT_EQ(ended.job.progress().committed_spp(), 32);
  EXPECT_GT(ended.job.progress().worst_tile_error(), 1e-3);
}

// Each delta takes 10 ms. A plan that would not end in time is not begun: the job ends at a
// decision, and what it has repeats (its counts are those that the same decisions give).
TEST(CoordinatorPlan, MaxTimeEndsBeforeAPlanThatDoesNotFit) {
  v1::JobSettings settings = AdaptiveSettings();
  settings.mutable_max_time()->set_seconds(3);
  SimulatedFarm farm;
  JudgePictures(&farm);
  const JobId job = farm.Create(settings);
  const SessionId worker = farm.Connect();
  int64_t deltas = 0;
  for (; farm.RenderOne(worker); ++deltas) farm.now_ms += 10;
  const v1::Job ended = farm.Job(job);
  EXPECT_EQ(ended.state(), v1::JOB_STATE_DONE);
  EXPECT_EQ(ended.stop_reason(), v1::STOP_REASON_MAX_TIME);
  EXPECT_LE(10 * deltas, 3000);
  EXPECT_GT(ended.progress().samples(), 2 * kPilotSpp * kWidth * kHeight);
  ASSERT_TRUE(ended.has_sample_counts());
  const std::vector<int64_t> samples = ExpandCounts(ended.sample_counts());
  EXPECT_GT(samples[0], samples[14]);
}

// The machine became slower amid a plan: the clock ends the job there, with all that has come.
TEST(CoordinatorPlan, MaxTimeEndsAmidAPlanThatTakesTooLong) {
  v1::JobSettings settings = AdaptiveSettings();
  settings.mutable_max_time()->set_seconds(3);
  SimulatedFarm farm;
  JudgePictures(&farm);
  const JobId job = farm.Create(settings);
  const SessionId worker = farm.Connect();
  while (farm.Job(job).progress().samples() <= kPilotSpp * kWidth * kHeight) {
    ASSERT_TRUE(farm.RenderOne(worker));
  }
  farm.now_ms += 3001;
  farm.Post(TickEvent{});
  const v1::Job ended = farm.Job(job);
  EXPECT_EQ(ended.state(), v1::JOB_STATE_DONE);
  EXPECT_EQ(ended.stop_reason(), v1::STOP_REASON_MAX_TIME);
  EXPECT_GT(ended.progress().samples(), kPilotSpp * kWidth * kHeight);
  ASSERT_TRUE(ended.has_sample_counts());
}

}  // namespace
}  // namespace tessera
