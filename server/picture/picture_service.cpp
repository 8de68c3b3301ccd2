#include "server/picture/picture_service.h"

#include <algorithm>
#include <chrono>
#include <functional>
#include <numeric>
#include <utility>

#include "server/coordinator/job_settings.h"

namespace tessera {
namespace {

constexpr int64_t kIntervalMinMs = 100;  // ten previews a second are enough
constexpr int64_t kRefineAfterMs = 300;  // without news, a job may have come to rest
constexpr int64_t kIdleKeepMs = 60000;   // how long a picture that nobody looks at is kept
// Of all pictures that nobody looks at: 9 Mpx of about 312 bytes, what the filter keeps included,
// are 2.7 GiB.
constexpr int64_t kIdlePixelsMax = int64_t{9} << 20;
constexpr int64_t kSleepMaxMs = 1000;
// Of a slice, for each thread: about a second at the default filter's final quality.
constexpr int64_t kSlicePixels = int64_t{1} << 16;

int64_t MonotonicMs() {
  return std::chrono::duration_cast<std::chrono::milliseconds>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

}  // namespace

PictureService::PictureService(PictureSource source, int num_threads, FilterDesk* desk)
    : source_(std::move(source)),
      num_threads_(num_threads),
      desk_(desk),
      threads_{std::thread([this] { Run(kPreviews); }),
               std::thread([this] { Run(kRefinements); })} {}

PictureService::~PictureService() { Stop(); }

void PictureService::Stop() {
  {
    std::lock_guard lock(mu_);
    stopping_ = true;
  }
  wake_.notify_all();
  for (std::thread& thread : threads_) {
    if (thread.joinable()) thread.join();
  }
  std::vector<Done> waiting;
  std::vector<std::unique_ptr<Refinement>> ended;  // whose windows are taken back without the lock
  {
    std::lock_guard lock(mu_);
    for (auto& [id, entry] : entries_) {
      std::ranges::move(entry.waiting, std::back_inserter(waiting));
      entry.waiting.clear();
      if (entry.refinement == nullptr) continue;
      std::ranges::move(entry.refinement->waiting, std::back_inserter(waiting));
      ended.push_back(std::move(entry.refinement));
    }
  }
  for (const Done& done : waiting) done(nullptr);
}

void PictureService::TileChanged(JobId job, int64_t tile) {
  std::lock_guard lock(mu_);
  const auto it = entries_.find(job);
  if (it == entries_.end()) return;
  it->second.blank = false;
  if (it->second.picture != nullptr) it->second.changed.insert(tile);
  if (it->second.watchers > 0) wake_.notify_all();
}

void PictureService::Evaluate(JobId job) {
  std::lock_guard lock(mu_);
  entries_[job].refine = true;
  wake_.notify_all();
}

void PictureService::Finish(JobId job) {
  std::lock_guard lock(mu_);
  entries_[job].finish = true;
  wake_.notify_all();
}

void PictureService::Remove(JobId job) {
  std::lock_guard lock(mu_);
  const auto it = entries_.find(job);
  if (it == entries_.end()) return;
  it->second.removed = true;
  wake_.notify_all();
}

void PictureService::Distrust(const std::string& host) {
  std::lock_guard lock(mu_);
  for (auto& [id, entry] : entries_) {
    if (entry.picture != nullptr) entry.picture->Distrust(host);
  }
  wake_.notify_all();
}

void PictureService::AddWatcher(JobId job) {
  std::lock_guard lock(mu_);
  ++entries_[job].watchers;
  wake_.notify_all();
}

void PictureService::RemoveWatcher(JobId job) {
  std::lock_guard lock(mu_);
  const auto it = entries_.find(job);
  if (it != entries_.end() && it->second.watchers > 0) --it->second.watchers;
}

void PictureService::Fetch(JobId job, bool wait, Done done) {
  std::shared_ptr<const Picture> ready;
  {
    std::lock_guard lock(mu_);
    if (!stopping_) {
      Entry& entry = entries_[job];
      entry.used_ms = MonotonicMs();
      const bool is_blank = entry.picture == nullptr || entry.picture->version() == 0 ||
                            (entry.picture->spp() == 0 && !entry.changed.empty());
      if (wait || is_blank) {
        entry.refine |= wait;
        entry.waiting.push_back(std::move(done));
        wake_.notify_all();
        return;
      }
      entry.wanted = true;
      wake_.notify_all();
      ready = entry.picture;
    }
  }
  done(std::move(ready));
}

void PictureService::Run(Lane lane) {
  std::unique_lock lock(mu_);
  while (!stopping_) {
    int64_t sleep_ms = kSleepMaxMs;
    const JobId job = Choose(lane, MonotonicMs(), &sleep_ms);
    if (job == 0) {
      wake_.wait_for(lock, std::chrono::milliseconds(sleep_ms));
      EvictIdle(MonotonicMs());
      continue;
    }
    under_way_[lane] = job;
    lock.unlock();
    RunRound(lane, job);
    lock.lock();
    under_way_[lane] = 0;
    wake_.notify_all();  // the other lane may have waited for this job
    EvictIdle(MonotonicMs());
  }
}

std::optional<int64_t> PictureService::DueMs(const Entry& entry) {
  if (entry.blank || (entry.watchers == 0 && !entry.wanted)) return std::nullopt;
  if (entry.picture == nullptr || !entry.changed.empty()) return entry.not_before_ms;
  if (entry.picture->is_refined()) return std::nullopt;
  return std::max(entry.not_before_ms, entry.refine_at_ms);
}

bool PictureService::IsUnderWay(JobId job) const {
  return std::ranges::find(under_way_, job) != under_way_.end();
}

JobId PictureService::Choose(Lane lane, int64_t now_ms, int64_t* sleep_ms) const {
  JobId first = 0;
  for (const auto& [id, entry] : entries_) {
    const bool is_refinement = entry.WantsQuality() || entry.removed;
    if (is_refinement != (lane == kRefinements) || IsUnderWay(id)) continue;
    if (!is_refinement) {
      const std::optional<int64_t> due_ms = entry.waiting.empty() ? DueMs(entry) : now_ms;
      if (!due_ms) continue;
      if (*due_ms > now_ms) {
        *sleep_ms = std::min(*sleep_ms, *due_ms - now_ms);
        continue;
      }
    }
    // In turn, so that a job that is asked for all the time keeps no other from its end.
    if (first == 0 || entry.last_round < entries_.at(first).last_round) first = id;
  }
  return first;
}

void PictureService::Abandon(JobId job) {
  std::vector<Done> waiting;
  std::unique_ptr<Refinement> ended;  // whose windows are taken back without the lock
  {
    std::lock_guard lock(mu_);
    const auto it = entries_.find(job);
    if (it == entries_.end()) return;
    waiting = std::move(it->second.waiting);
    if (it->second.refinement != nullptr) {
      std::ranges::move(it->second.refinement->waiting, std::back_inserter(waiting));
      ended = std::move(it->second.refinement);
    }
    entries_.erase(it);
  }
  for (const Done& done : waiting) done(nullptr);
}

std::shared_ptr<Picture> PictureService::TakeChanges(JobId job, const PictureSource::JobView& view,
                                                     std::vector<int64_t>* changed) {
  std::shared_ptr<Picture> fresh;
  {
    std::lock_guard lock(mu_);
    Entry& entry = entries_[job];
    if (entry.picture != nullptr) {
      changed->assign(entry.changed.begin(), entry.changed.end());
      entry.changed.clear();
      return entry.picture;
    }
  }
  // Whatever the film has by now is taken; TileChanged is recorded once the entry has the picture.
  fresh = std::make_shared<Picture>(view.settings);
  changed->resize(static_cast<size_t>(view.film->grid().num_tiles()));
  std::iota(changed->begin(), changed->end(), 0);
  std::lock_guard lock(mu_);
  entries_[job].picture = fresh;
  return fresh;
}

void PictureService::RunRound(Lane lane, JobId job) {
  std::shared_ptr<Picture> refined;
  bool refine = false, removed = false;
  {
    std::lock_guard lock(mu_);
    Entry& entry = entries_[job];
    entry.last_round = ++num_rounds_;
    removed = entry.removed;
    entry.blank = entry.picture == nullptr;
    if (entry.refinement != nullptr) refined = entry.picture;
    if (lane == kRefinements && refined == nullptr) refine = std::exchange(entry.refine, false);
  }
  if (removed) return Abandon(job);
  if (refined != nullptr) return RunSlice(job, refined);
  // The committed state is read before the changes are taken: the picture shows at least that.
  const std::unique_ptr<PictureSource::JobView> view = source_.view(job);
  if (view == nullptr) return Abandon(job);
  Refinement round{.view = *view, .begin_ms = MonotonicMs()};
  {
    std::lock_guard lock(mu_);
    Entry& entry = entries_[job];
    // What has been asked for since the round began leads to another one, as the view may be older;
    // if it is not, this round's answer counts and must have the job's quality.
    refine |= entry.refine || entry.finish;
    const bool is_asked_for = refine || !entry.waiting.empty();
    if (view->has_samples || is_asked_for) entry.blank = false;
    entry.wanted = false;
    if (entry.picture == nullptr && !view->has_samples && !is_asked_for) {
      entry.used_ms = MonotonicMs();
      return;
    }
    refine |= !view->is_sampling;
    if (refine && lane == kPreviews) {  // for the other lane
      entry.refine = true;
      return;
    }
    round.waiting = std::exchange(entry.waiting, {});
    round.finish = std::exchange(entry.finish, false);
  }
  std::vector<int64_t> changed;
  const std::shared_ptr<Picture> picture = TakeChanges(job, *view, &changed);
  const auto source = [&](int64_t tile) { return source_.fold_tile(*view->film, tile); };
  if (!refine) {
    if (!changed.empty()) {
      round.cpu_seconds =
          picture->Update(changed, source, DenoiseQuality::kPreview, num_threads_);
    }
    return EndRound(job, picture, std::move(round), false);
  }
  if (!changed.empty()) round.cpu_seconds = picture->Absorb(changed, source, num_threads_);
  if (desk_ != nullptr) round.leased = std::make_unique<LeasedWindows>(*desk_, job);
  {
    std::lock_guard lock(mu_);
    entries_[job].refinement = std::make_unique<Refinement>(std::move(round));
  }
  RunSlice(job, picture);
}

void PictureService::RunSlice(JobId job, const std::shared_ptr<Picture>& picture) {
  double cpu_seconds = 0;
  if (!picture->is_refined()) {
    LeasedWindows* leased = nullptr;
    {
      std::lock_guard lock(mu_);
      leased = entries_[job].refinement->leased.get();
    }
    cpu_seconds = picture->Refine(kSlicePixels * num_threads_, num_threads_, leased);
  }
  Refinement round;
  {
    std::lock_guard lock(mu_);
    Entry& entry = entries_[job];
    entry.refinement->cpu_seconds += cpu_seconds;
    if (!picture->is_refined()) return;
    round = std::move(*entry.refinement);
    entry.refinement.reset();
  }
  EndRound(job, picture, std::move(round), true);
}

void PictureService::EndRound(JobId job, const std::shared_ptr<Picture>& picture, Refinement round,
                              bool is_refined) {
  const auto cores = std::max(1u, std::thread::hardware_concurrency());
  const auto pause_ms = static_cast<int64_t>(1e3 * round.cpu_seconds / (kPreviewShare * cores));
  {
    std::lock_guard lock(mu_);
    Entry& entry = entries_[job];
    entry.used_ms = MonotonicMs();
    entry.not_before_ms = round.begin_ms + std::max(kIntervalMinMs, pause_ms);
    entry.refine_at_ms = entry.used_ms + kRefineAfterMs;
  }
  if (round.cpu_seconds > 0 || is_refined) {
    PictureEvent event{.job = job,
                       .samples = round.view.samples,
                       .estimated_error = picture->estimated_error(),
                       .filter_core_seconds = round.cpu_seconds,
                       .is_refined = is_refined};
    if (is_refined && DecidesByPicture(round.view.settings)) {
      event.cell_errors = picture->CellErrors();
      event.error_bound = ErrorBound(event.cell_errors, picture->region().area());
    }
    source_.on_picture(event);
  }
  if (round.finish) source_.on_finished({job, round.view.film->Digest()});
  for (const Done& done : round.waiting) done(picture);
}

void PictureService::EvictIdle(int64_t now_ms) {
  const auto is_idle = [this](const std::pair<const JobId, Entry>& item) {
    const Entry& entry = item.second;
    return entry.watchers == 0 && entry.waiting.empty() && !entry.WantsQuality() &&
           !entry.wanted && !IsUnderWay(item.first);
  };
  std::erase_if(entries_, [&](const auto& item) {
    return is_idle(item) && now_ms - item.second.used_ms > kIdleKeepMs;
  });
  // Whoever looks through the pictures of many jobs leaves them all behind: the newest stay.
  std::vector<std::pair<int64_t, JobId>> idle;  // (used_ms, job)
  for (const auto& item : entries_) {
    if (!is_idle(item) || item.second.picture == nullptr) continue;
    idle.emplace_back(item.second.used_ms, item.first);
  }
  std::ranges::sort(idle, std::greater<>());
  int64_t pixels = 0;
  for (const auto& [used_ms, id] : idle) {
    pixels += entries_.at(id).picture->region().area();
    if (pixels > kIdlePixelsMax) entries_.erase(id);
  }
}

}  // namespace tessera
