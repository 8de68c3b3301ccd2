// Keeps the pictures of jobs up to date in the background, as far as somebody looks at them:
// nothing is filtered while nobody watches or fetches, of a part that somebody looks at the tiles
// that it touches and no others, and a watched job that waits for its turn has no picture in
// memory; with a watcher, filtering takes at most kPreviewShare of the machine,
// and the rate follows from what a round costs. Latest wins: a round takes whatever has changed
// since the last one. Previews of a job that is sampled are filtered at preview quality; at rest,
// or when somebody waits, the picture has the job's. Previews have a thread of their own, so that
// none waits while another job's picture is refined.
#pragma once

#include <array>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "core/base/sha256.h"
#include "server/coordinator/event.h"
#include "server/picture/filter_desk.h"
#include "server/picture/leased_windows.h"
#include "server/picture/picture.h"
#include "server/picture/views.h"

namespace tessera {

// Where pictures come from and what they lead to; all callable from the service's two threads.
struct PictureSource {
  struct JobView {
    v1::JobSettings settings;
    int64_t samples = 0;        // of the film
    bool is_sampling = false;  // more samples are to come
    std::shared_ptr<const Film> film;
    bool has_samples = true;  // the film
  };
  // null: the job does not exist.
  std::function<std::unique_ptr<JobView>(JobId)> view;
  // Folds a tile of a view's film, which others may be writing to. Threads: any number at once.
  std::function<TileStatistics(const Film&, int64_t tile)> fold_tile;
  std::function<void(const PictureEvent&)> on_picture;
  std::function<void(const JobFinishedEvent&)> on_finished;
};

// Threads: all methods from any thread.
class PictureService {
 public:
  static constexpr double kPreviewShare = 0.15;

  // num_threads >= 1: that filter. desk: through which workers filter, too; null = none does. It
  // must outlive the service.
  PictureService(PictureSource source, int num_threads, FilterDesk* desk = nullptr);
  ~PictureService();  // Stop

  // From the coordinator's effects; never block.
  void TileChanged(JobId job, int64_t tile);
  void Evaluate(JobId job);
  void Finish(JobId job);
  void Remove(JobId job);
  // What the host has filtered is filtered again.
  void Distrust(const std::string& host);

  // A part of the picture, in frame coordinates; absent: all that the job renders; without pixels:
  // nothing.
  using Region = std::optional<PixelRect>;
  // Somebody looks at it until RemoveWatcher with the same region.
  void AddWatcher(JobId job, const Region& region);
  void RemoveWatcher(JobId job, const Region& region);

  // Calls done(picture), on one of the service's threads or at once, when the picture shows in
  // `region` at least everything that had been merged before the call, at the job's quality (wait),
  // or else any moment, but samples if there are any. null: the job does not exist any more, or the
  // service stops.
  using Done = std::function<void(std::shared_ptr<const Picture>)>;
  void Fetch(JobId job, const Region& region, bool wait, Done done);

  FilterDesk::Totals filter_totals() const {
    return desk_ == nullptr ? FilterDesk::Totals() : desk_->totals();
  }

  // Ends the threads; waiting fetches get null. Idempotent.
  void Stop();

 private:
  struct Waiter {
    Region region;
    bool wait = false;  // for the job's quality
    Done done;
  };
  // What is looked at of a picture on its way to the job's quality, slice by slice, or of a
  // preview, and who waits for it.
  struct Round {
    PictureSource::JobView view;
    Views views{};
    std::unique_ptr<LeasedWindows> leased{};  // null: without workers
    std::vector<Waiter> waiting{};
    bool finish = false;
    int64_t begin_ms = 0;
    double cpu_seconds = 0;
  };
  struct Entry {
    std::shared_ptr<Picture> picture;  // null until somebody looks
    std::unique_ptr<Round> refinement{};  // null: none under way
    std::set<int64_t> changed;         // tiles, since `picture` took them
    std::vector<Waiter> waiting;
    std::vector<Region> watchers;
    Views wanted;   // fetches that did not wait would like them newer
    Views refine;   // to the job's quality
    bool finish = false;
    bool news = false;   // what is looked at may have changed since the last round
    bool rough = false;  // or may not have the job's quality
    bool removed = false;  // the job is
    bool blank = false;    // without samples when last looked at, and no tile has changed since
    int64_t not_before_ms = 0;
    int64_t refine_at_ms = 0;  // unless more tiles change
    int64_t used_ms = 0;
    int64_t last_round = 0;  // its number, or its last slice's

    bool WantsQuality() const;
    // What the watchers and the last fetches look at.
    Views LookedAt() const;
  };

  // What each of the two threads is for. A job's picture is with one of them at a time.
  enum Lane { kPreviews, kRefinements, kNumLanes };

  void Run(Lane lane);
  // When the entry's next round is due for those who look on; nullopt: never.
  static std::optional<int64_t> DueMs(const Entry& entry);
  bool IsUnderWay(JobId job) const;
  // The job whose picture has its turn in the lane; 0 = none, and then *sleep_ms is how long to
  // sleep. Jobs take turns.
  JobId Choose(Lane lane, int64_t now_ms, int64_t* sleep_ms) const;
  // A preview, or the first slice of a refinement.
  void RunRound(Lane lane, JobId job);
  // The next slice of the job's refinement, and what follows from its last one.
  void RunSlice(JobId job, const std::shared_ptr<Picture>& picture);
  // Ends a round: when the next may begin, what was found, and who waited for it.
  void EndRound(JobId job, const std::shared_ptr<Picture>& picture, Round round, bool is_refined);
  // Who can be answered by the refinement under way joins it; *first are the parts that are waited
  // for. Needs mu_.
  static void JoinRefinement(Entry& entry, Views* first);
  // Notes what the tile's news mean for those who look on. Needs mu_.
  static void NoteNews(Entry& entry, int64_t tile, const Views& views);
  // Notes that somebody looks at the views from now on. Needs mu_.
  static void NoteLook(Entry& entry, const Views& views);
  void Abandon(JobId job);
  // Creates the picture if need be and moves what has changed since the last round, and reaches
  // round.views, to *changed.
  std::shared_ptr<Picture> TakeChanges(JobId job, const Round& round, DenoiseQuality quality,
                                       std::vector<int64_t>* changed);
  void EvictIdle(int64_t now_ms);

  const PictureSource source_;
  const int num_threads_;
  FilterDesk* const desk_;
  std::mutex mu_;  // guards all below
  std::condition_variable wake_;
  std::map<JobId, Entry> entries_;
  int64_t num_rounds_ = 0;
  std::array<JobId, kNumLanes> under_way_ = {};  // whose round each lane runs; 0: none
  bool stopping_ = false;
  std::array<std::thread, kNumLanes> threads_;
};

}  // namespace tessera
