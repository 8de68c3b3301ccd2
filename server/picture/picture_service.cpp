#include "server/picture/picture_service.h"

#include <algorithm>
#include <chrono>
#include <cmath>
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
  std::vector<Waiter> waiting;
  std::vector<std::unique_ptr<Round>> ended;  // whose windows are taken back without the lock
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
  for (const Waiter& waiter : waiting) waiter.done(nullptr);
}

void PictureService::TileChanged(JobId job, int64_t tile) {
  std::lock_guard lock(mu_);
  const auto it = entries_.find(job);
  if (it == entries_.end()) return;
  Entry& entry = it->second;
  entry.blank = false;
  if (entry.picture != nullptr) {
    entry.changed.insert(tile);
    NoteNews(entry, tile, entry.LookedAt());
  }
  if (!entry.watchers.empty() && (entry.news || entry.picture == nullptr)) wake_.notify_all();
}

void PictureService::NoteNews(Entry& entry, int64_t tile, const Views& views) {
  entry.news |= entry.picture->Reaches(tile, views, DenoiseQuality::kPreview);
  entry.rough |= entry.picture->Reaches(tile, views, DenoiseQuality::kFinal);
}

void PictureService::NoteLook(Entry& entry, const Views& views) {
  if (entry.picture == nullptr) return;
  for (const int64_t tile : entry.changed) NoteNews(entry, tile, views);
  // Of this part or another; the next round finds out.
  entry.rough |= !entry.picture->is_refined();
}

bool PictureService::Entry::WantsQuality() const {
  return refinement != nullptr || !refine.empty() || finish ||
         std::ranges::any_of(waiting, [](const Waiter& waiter) { return waiter.wait; });
}

Views PictureService::Entry::LookedAt() const {
  Views views = wanted;
  for (const Region& region : watchers) views.Add(region);
  return views;
}

void PictureService::Evaluate(JobId job) {
  std::lock_guard lock(mu_);
  entries_[job].refine = Views::Whole();
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
    if (entry.picture == nullptr) continue;
    entry.picture->Distrust(host);
    entry.rough |= !entry.picture->is_refined();
  }
  wake_.notify_all();
}

void PictureService::AddWatcher(JobId job, const Region& region) {
  if (region.has_value() && region->empty()) return;
  std::lock_guard lock(mu_);
  Entry& entry = entries_[job];
  entry.watchers.push_back(region);
  Views views;
  views.Add(region);
  NoteLook(entry, views);
  wake_.notify_all();
}

void PictureService::RemoveWatcher(JobId job, const Region& region) {
  std::lock_guard lock(mu_);
  const auto it = entries_.find(job);
  if (it == entries_.end()) return;
  std::vector<Region>& watchers = it->second.watchers;
  if (const auto found = std::ranges::find(watchers, region); found != watchers.end()) {
    watchers.erase(found);
  }
}

void PictureService::Fetch(JobId job, const Region& region, bool wait, Done done) {
  std::shared_ptr<const Picture> ready;
  {
    std::lock_guard lock(mu_);
    if (!stopping_) {
      Entry& entry = entries_[job];
      entry.used_ms = MonotonicMs();
      Views views;
      views.Add(region);
      const bool is_blank =
          entry.picture == nullptr || !entry.picture->HasShown(region) ||
          (!entry.changed.empty() &&
           (region ? entry.picture->spp(*region) : entry.picture->spp()) == 0);
      if (wait || is_blank) {
        entry.waiting.push_back({region, wait, std::move(done)});
        wake_.notify_all();
        return;
      }
      entry.wanted.Add(views);
      NoteLook(entry, views);
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
  if (entry.blank || (entry.watchers.empty() && entry.wanted.empty())) return std::nullopt;
  if (entry.picture == nullptr || entry.news) return entry.not_before_ms;
  if (!entry.rough) return std::nullopt;
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
  std::vector<Waiter> waiting;
  std::unique_ptr<Round> ended;  // whose windows are taken back without the lock
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
  for (const Waiter& waiter : waiting) waiter.done(nullptr);
}

std::shared_ptr<Picture> PictureService::TakeChanges(JobId job, const Round& round,
                                                     DenoiseQuality quality,
                                                     std::vector<int64_t>* changed) {
  std::shared_ptr<Picture> fresh;
  std::unique_lock lock(mu_);
  if (entries_[job].picture == nullptr) {
    lock.unlock();
    fresh = std::make_shared<Picture>(round.view.settings);
    lock.lock();
  }
  Entry& entry = entries_[job];
  if (fresh != nullptr) {
    // Whatever the film has by now counts; TileChanged is recorded once the entry has the picture.
    entry.picture = fresh;
    for (int64_t tile = 0; tile < round.view.film->grid().num_tiles(); ++tile) {
      entry.changed.insert(entry.changed.end(), tile);
    }
  }
  std::erase_if(entry.changed, [&](int64_t tile) {
    if (!entry.picture->Reaches(tile, round.views, quality)) return false;
    changed->push_back(tile);
    return true;
  });
  return entry.picture;
}

void PictureService::RunRound(Lane lane, JobId job) {
  std::shared_ptr<Picture> refined;
  Views refine;
  bool removed = false;
  {
    std::lock_guard lock(mu_);
    Entry& entry = entries_[job];
    entry.last_round = ++num_rounds_;
    removed = entry.removed;
    entry.blank = entry.picture == nullptr;
    if (entry.refinement != nullptr) refined = entry.picture;
    if (lane == kRefinements && refined == nullptr) refine = std::exchange(entry.refine, {});
  }
  if (removed) return Abandon(job);
  if (refined != nullptr) return RunSlice(job, refined);
  // The committed state is read before the changes are taken: the picture shows at least that.
  const std::unique_ptr<PictureSource::JobView> view = source_.view(job);
  if (view == nullptr) return Abandon(job);
  Round round{.view = *view, .begin_ms = MonotonicMs()};
  {
    std::lock_guard lock(mu_);
    Entry& entry = entries_[job];
    // What has been asked for since the round began leads to another one, as the view may be older;
    // if it is not, this round's answer counts and must have the job's quality.
    refine.Add(entry.refine);
    if (entry.finish) refine = Views::Whole();
    round.views = entry.LookedAt();
    for (const Waiter& waiter : entry.waiting) {
      round.views.Add(waiter.region);
      if (waiter.wait) refine.Add(waiter.region);
    }
    const bool is_asked_for = !refine.empty() || !entry.waiting.empty();
    if (view->has_samples || is_asked_for) entry.blank = false;
    entry.wanted = {};
    entry.news = false;
    if (entry.picture == nullptr && !view->has_samples && !is_asked_for) {
      entry.used_ms = MonotonicMs();
      return;
    }
    if (!view->is_sampling) refine.Add(round.views);
    if (!refine.empty() && lane == kPreviews) {  // for the other lane
      entry.refine.Add(refine);
      return;
    }
    round.waiting = std::exchange(entry.waiting, {});
    round.finish = std::exchange(entry.finish, false);
  }
  if (!refine.empty()) {
    round.views = refine;
    for (const Waiter& waiter : round.waiting) round.views.Add(waiter.region);
  }
  std::vector<int64_t> changed;
  const std::shared_ptr<Picture> picture = TakeChanges(
      job, round, refine.empty() ? DenoiseQuality::kPreview : DenoiseQuality::kFinal, &changed);
  const auto source = [&](int64_t tile) { return source_.fold_tile(*view->film, tile); };
  if (refine.empty()) {
    round.cpu_seconds = picture->Update(changed, source, DenoiseQuality::kPreview, num_threads_,
                                        round.views);
    return EndRound(job, picture, std::move(round), false);
  }
  if (!changed.empty()) round.cpu_seconds = picture->Absorb(changed, source, num_threads_);
  if (desk_ != nullptr) round.leased = std::make_unique<LeasedWindows>(*desk_, job);
  {
    std::lock_guard lock(mu_);
    entries_[job].refinement = std::make_unique<Round>(std::move(round));
  }
  RunSlice(job, picture);
}

void PictureService::JoinRefinement(Entry& entry, Views* first) {
  Round& round = *entry.refinement;
  // A part of the whole is no more work.
  for (auto it = entry.waiting.begin(); it != entry.waiting.end() && round.views.is_whole();) {
    Views views;
    views.Add(it->region);
    const bool has_news = std::ranges::any_of(entry.changed, [&](int64_t tile) {
      return entry.picture->Reaches(tile, views, DenoiseQuality::kFinal);
    });
    if (has_news) {
      ++it;
      continue;
    }
    round.waiting.push_back(std::move(*it));
    it = entry.waiting.erase(it);
  }
  for (const Waiter& waiter : round.waiting) {
    if (waiter.region.has_value()) first->Add(waiter.region);
  }
}

void PictureService::RunSlice(JobId job, const std::shared_ptr<Picture>& picture) {
  Round* refinement = nullptr;  // this thread's alone
  Views first;
  {
    std::lock_guard lock(mu_);
    Entry& entry = entries_[job];
    JoinRefinement(entry, &first);
    refinement = entry.refinement.get();
  }
  LeasedWindows* const leased = refinement->leased.get();
  if (!picture->IsRefined(refinement->views, leased)) {
    refinement->cpu_seconds += picture->Refine(kSlicePixels * num_threads_, num_threads_, leased,
                                               refinement->views, first);
  }
  const bool is_over = picture->IsRefined(refinement->views, leased);
  std::vector<Waiter> answered;
  Round round;
  {
    std::lock_guard lock(mu_);
    std::vector<Waiter>& waiting = refinement->waiting;
    const auto part =
        std::stable_partition(waiting.begin(), waiting.end(), [&](const Waiter& waiter) {
          Views views;
          views.Add(waiter.region);
          return !is_over && !picture->IsRefined(views, leased);
        });
    std::move(part, waiting.end(), std::back_inserter(answered));
    waiting.erase(part, waiting.end());
    if (is_over) {
      round = std::move(*refinement);
      entries_[job].refinement.reset();
    }
  }
  if (is_over) {
    round.waiting = std::move(answered);
    return EndRound(job, picture, std::move(round), true);
  }
  for (const Waiter& waiter : answered) waiter.done(picture);
}

void PictureService::EndRound(JobId job, const std::shared_ptr<Picture>& picture, Round round,
                              bool is_refined) {
  const auto cores = std::max(1u, std::thread::hardware_concurrency());
  const auto pause_ms = static_cast<int64_t>(1e3 * round.cpu_seconds / (kPreviewShare * cores));
  {
    std::lock_guard lock(mu_);
    Entry& entry = entries_[job];
    entry.used_ms = MonotonicMs();
    entry.not_before_ms = round.begin_ms + std::max(kIntervalMinMs, pause_ms);
    entry.refine_at_ms = entry.used_ms + kRefineAfterMs;
    const Views views = entry.LookedAt();
    entry.rough = !picture->IsRefined(views);
    for (const int64_t tile : entry.changed) {
      entry.rough |= picture->Reaches(tile, views, DenoiseQuality::kFinal);
    }
  }
  // The answer to Evaluate; of a part, news.
  is_refined = is_refined && round.views.is_whole();
  if (round.cpu_seconds > 0 || is_refined) {
    PictureEvent event{.job = job,
                       .samples = round.view.samples,
                       .estimated_error = picture->estimated_error(),
                       .filter_core_seconds = round.cpu_seconds,
                       .filter_seconds = 1e-3 * static_cast<double>(MonotonicMs() - round.begin_ms),
                       .is_refined = is_refined};
    if (is_refined && DecidesByPicture(round.view.settings)) {
      event.cell_errors = picture->CellErrors();
      event.error_bound = ErrorBound(event.cell_errors, picture->region().area());
      if (std::isfinite(event.error_bound)) event.estimated_error = event.error_bound;
    }
    source_.on_picture(event);
  }
  if (round.finish) source_.on_finished({job, round.view.film->Digest()});
  for (const Waiter& waiter : round.waiting) waiter.done(picture);
}

void PictureService::EvictIdle(int64_t now_ms) {
  const auto is_idle = [this](const std::pair<const JobId, Entry>& item) {
    const Entry& entry = item.second;
    return entry.watchers.empty() && entry.waiting.empty() && !entry.WantsQuality() &&
           entry.wanted.empty() && !IsUnderWay(item.first);
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
