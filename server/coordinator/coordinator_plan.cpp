// Jobs that sample adaptively: which tile's samples end where, epoch by epoch.
#include <algorithm>
#include <cmath>
#include <utility>

#include "server/coordinator/coordinator.h"
#include "server/coordinator/coordinator_state.h"
#include "server/coordinator/sample_counts.h"
#include "server/coordinator/sample_plan.h"

namespace tessera {

// The plan is on its way to disk before a sample of it is asked for; a restart that knows an older
// one alone has RestorePlan.
void Coordinator::TakePlan(Job& job, std::vector<int64_t> plan) {
  job.plan = std::move(plan);
  MakeQueue(job);
  UpdateProgress(job);
  Touch(job);
  Save(job, false);
}

void Coordinator::NotePlanFloor(Job& job) {
  if (!job.plan.empty()) job.plan_floor = job.film->CommittedEnd();
}

bool Coordinator::MeetsTarget(const PictureEvent& picture, const v1::JobSettings& settings) {
  return picture.estimated_error > 0 && picture.error_bound <= settings.target_error();
}

// All tiles have the samples of the plan before, and its picture is at the job's quality.
void Coordinator::DecideNextPlan(Job& job, const PictureEvent& picture) {
  const v1::JobSettings& settings = job.record.settings();
  const std::vector<CellState> cells = CellsOf(job, picture.cell_errors);
  const double worst = std::ranges::max(CellErrors(job.grid, cells));
  job.record.mutable_progress()->set_worst_tile_error(std::isfinite(worst) ? worst : 0);
  ErrorTargets left{.image = settings.target_error(), .cell = settings.target_tile_error()};
  if (MeetsTarget(picture, settings)) left.image = 0;
  if (worst <= left.cell) left.cell = 0;
  if (HasTargetError(settings) && left.image == 0 && left.cell == 0) {
    return Finish(job, v1::STOP_REASON_TARGET_ERROR);
  }
  std::vector<int64_t> plan = PlanSamples(job.grid, cells, left, settings.spp());
  if (plan == job.plan) return Finish(job, v1::STOP_REASON_SPP);
  if (settings.has_max_time() && !PlanFits(job, plan)) {
    return Finish(job, v1::STOP_REASON_MAX_TIME);
  }
  TakePlan(job, std::move(plan));
}

std::vector<CellState> Coordinator::CellsOf(const Job& job,
                                            const std::vector<CellError>& errors) const {
  std::vector<CellState> cells(job.plan.size());
  for (size_t tile = 0; tile < cells.size(); ++tile) {
    cells[tile] = {.samples = job.plan[tile],
                   .rays = job.costs.empty() ? 0 : job.costs[tile].rays,
                   .error = errors[tile]};
  }
  return cells;
}

// Whether the plan is likely to end in time, at the speed so far.
bool Coordinator::PlanFits(const Job& job, const std::vector<int64_t>& plan) const {
  const int64_t samples = job.film->samples();
  if (samples <= job.start_samples || job.first_merge_ms == 0) return true;
  const int64_t planned = SamplesOf(job.grid, plan);
  const double ms_per_sample = static_cast<double>(now_.monotonic_ms - job.first_merge_ms) /
                               static_cast<double>(samples - job.start_samples);
  return static_cast<double>(job.ElapsedMs(now_.monotonic_ms)) +
             ms_per_sample * static_cast<double>(planned - samples) <=
         static_cast<double>(MaxTimeMs(job.record.settings()));
}

// What the catalogue knows of the plan. The film may have been stored later, with samples of the
// plan that followed: a tile that has more than it should when the next decision is taken starts
// over, or that decision would be another one (C2).
void Coordinator::RestorePlan(Job& job) {
  const v1::SampleCounts& counts = job.record.plan();
  if (CheckCounts(counts, job.grid.num_tiles(), job.record.settings().spp()).ok()) {
    job.plan = ExpandCounts(counts);
  }
  job.record.clear_plan();
  if (std::ssize(job.plan) != job.grid.num_tiles()) {
    job.plan.assign(static_cast<size_t>(job.grid.num_tiles()),
                    std::min(kPilotSpp, job.record.settings().spp()));
  }
  for (int64_t tile = 0; tile < job.grid.num_tiles(); ++tile) {
    const int64_t end = job.plan[static_cast<size_t>(tile)];
    const std::vector<TileStatistics>& nodes = job.film->Nodes(tile);
    if (!nodes.empty() && nodes.back().range().end > end) ResetTile(job, tile);
  }
}

void Coordinator::ResetTile(Job& job, int64_t tile) {
  job.film->ResetTile(tile);
  if (!job.costs.empty()) job.costs[static_cast<size_t>(tile)] = {};
}

}  // namespace tessera
