#include "worker/session/render_pool.h"

#include <utility>

#include "worker/session/thread_time.h"

namespace tessera {
RenderPool::RenderPool(int threads, DeltaEncoding encoding, UnitJournal* journal, Done done)
    : encoding_(encoding), journal_(journal), done_(std::move(done)) {
  for (int i = 0; i < threads; ++i) threads_.emplace_back([this, i] { Run(i); });
}

RenderPool::~RenderPool() {
  {
    std::lock_guard lock(mu_);
    stopping_ = true;
    for (const auto& [id, task] : alive_) task->cancelled = true;
  }
  cv_.notify_all();
  for (std::thread& thread : threads_) thread.join();
}

void RenderPool::Start(uint64_t id, std::shared_ptr<const Renderer> renderer,
                       const v1::Lease& lease) {
  auto task = std::make_shared<Task>();
  task->id = id;
  task->renderer = std::move(renderer);
  task->lease = lease;
  Enqueue(std::move(task));
}

void RenderPool::Start(uint64_t id, Job job) {
  auto task = std::make_shared<Task>();
  task->id = id;
  task->job = std::move(job);
  Enqueue(std::move(task));
}

void RenderPool::Enqueue(std::shared_ptr<Task> task) {
  {
    std::lock_guard lock(mu_);
    alive_[task->id] = task;
    queue_.push_back(std::move(task));
  }
  cv_.notify_one();
}

void RenderPool::Cancel(uint64_t id) {
  std::lock_guard lock(mu_);
  if (const auto task = alive_.find(id); task != alive_.end()) task->second->cancelled = true;
}

int64_t RenderPool::SamplesOf(uint64_t id) const {
  std::lock_guard lock(mu_);
  const auto task = alive_.find(id);
  return task == alive_.end() ? 0 : task->second->samples_done.load(std::memory_order_relaxed);
}

void RenderPool::Run(int slot) {
  while (true) {
    std::shared_ptr<Task> task;
    {
      std::unique_lock lock(mu_);
      cv_.wait(lock, [this] { return stopping_ || !queue_.empty(); });
      if (stopping_) return;
      task = std::move(queue_.front());
      queue_.pop_front();
    }
    if (task->job) {
      task->job(task->cancelled, &task->samples_done);
      std::lock_guard lock(mu_);
      alive_.erase(task->id);
      continue;
    }
    if (journal_ != nullptr) journal_->BeginUnit(slot, task->lease);
    absl::StatusOr<v1::TileDelta> delta = Render(*task);
    if (journal_ != nullptr) journal_->EndUnit(slot);
    {
      std::lock_guard lock(mu_);
      alive_.erase(task->id);
    }
    done_(task->id, std::move(delta));
  }
}

absl::StatusOr<v1::TileDelta> RenderPool::Render(Task& task) const {
  if (task.cancelled) return absl::CancelledError("cancelled before it began");
  const v1::Region& region = task.lease.window();
  const PixelRect window =
      PixelRect::FromSize(region.x(), region.y(), region.width(), region.height());
  const SampleRange range{task.lease.sample_begin(), task.lease.sample_end()};

  const int64_t begin = ThreadNanoseconds();
  RenderCounters counters;
  counters.samples_done = &task.samples_done;
  const absl::StatusOr<TileStatistics> tile =
      task.renderer->Render(window, range, &task.cancelled, &counters);
  if (!tile.ok()) return tile.status();
  const int64_t nanoseconds = ThreadNanoseconds() - begin;

  EncodedDelta encoded = EncodeDelta(*tile, encoding_);
  v1::TileDelta delta;
  delta.set_lease_id(task.lease.id());
  delta.set_job(task.lease.job());
  delta.set_tile_index(task.lease.tile_index());
  *delta.mutable_window() = region;
  delta.set_sample_begin(range.begin);
  delta.set_sample_end(range.end);
  delta.set_feature_end(tile->feature_end());
  delta.set_checksum(DeltaChecksum({.lease_id = task.lease.id(),
                                    .job = task.lease.job(),
                                    .tile_index = task.lease.tile_index(),
                                    .window = window,
                                    .range = range,
                                    .feature_end = tile->feature_end(),
                                    .rays = counters.rays,
                                    .max_depth = task.renderer->max_depth()},
                                   encoded.payload));
  delta.set_payload(std::move(encoded.payload));
  delta.set_encoding(static_cast<uint32_t>(encoded.encoding));
  delta.set_payload_bytes(encoded.payload_bytes);
  delta.set_rays(counters.rays);
  delta.set_non_finite(counters.non_finite);
  delta.set_max_depth(task.renderer->max_depth());
  delta.mutable_render_time()->set_seconds(nanoseconds / 1000000000);
  delta.mutable_render_time()->set_nanos(static_cast<int32_t>(nanoseconds % 1000000000));
  return delta;
}

}  // namespace tessera
