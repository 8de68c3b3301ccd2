#include "tests/sim/sim_server.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <map>
#include <memory>
#include <set>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/coordinator/worker_message.h"
#include "server/event_log.h"
#include "core/denoise/window_codec.h"
#include "server/picture/filter_desk.h"
#include "server/restore.h"
#include "tests/sim/sim_scene.h"

namespace tessera {

struct PixelRectLess {
  bool operator()(const PixelRect& a, const PixelRect& b) const {
    return std::pair(a.y_begin, a.x_begin) < std::pair(b.y_begin, b.x_begin);
  }
};

// One process, from its start to its death.
class SimServer::Run : public EffectSink {
 public:
  Run(SimServer& server, uint64_t id)
      : server_(server),
        id_(id),
        clock_offset_ms_(server.random_.Between(1, 1000000)),
        rows_(server.platter_, [this] { return alive_; }),
        films_(server.platter_, [this] { return alive_; }, [this] { PassTime(); }),
        host_(Config(), *this, [this] { return last_step_ = Now(); }),
        desk_({FilterOn::kWorkers, Config().audit_rate, Config().audit_seed},
              [this](Event event) { (void)host_.Post(std::move(event)); },
              [this](JobId job) {
                return host_.Read([&](const Coordinator& c) { return c.FilterRoom(job, Now()); });
              }),
        saver_(&rows_, &films_, server.assets_.get(),
               [this] { return JobSaver::Clock::time_point(std::chrono::milliseconds(NowMs())); }),
        requests_(host_, *server.assets_, Config().defaults,
                  {[this](JobId job) { return alive_ ? saver_.SaveNow(job) : Dead(); },
                   [this](JobId job) { return alive_ ? saver_.RemoveNow(job) : Dead(); }}) {
    saver_.Attach(&host_);
  }

  absl::Status Restore() {
    const absl::Status status =
        RestoreJobs(rows_, films_, *server_.assets_, Config().defaults, host_);
    for (const auto& [host, ban] : server_.platter_.bans) banned_.insert(host);
    (void)FilmsReset();
    return status;
  }
  absl::Status Post(Event event) {
    if (!alive_) return Dead();
    return host_.Post(std::move(event)).status;
  }
  // Checks what the steps since the last call have led to, and writes what is to be written.
  void Settle() {
    if (!alive_) return;
    const std::set<JobId> changed = std::exchange(changed_, {});
    host_.Read(
        [&](const Coordinator& c) { server_.checkers_.AfterStep(c, changed, last_step_); });
    if (save_due_ || saving_) return;
    save_due_ = true;
    After(server_.random_.Between(1, 20) * kMs, [this] {
      save_due_ = false;
      saving_ = true;
      while (alive_ && saver_.WriteDue()) {
      }
      saving_ = false;
    });
  }
  void Apply(const Effect& effect) override {
    if (alive_) std::visit([this](const auto& e) { On(e); }, effect);
  }
  // Nothing of it happens any more. Whatever runs in it just now still holds it.
  void Kill() { alive_ = false; }

  Instant Now() const { return {NowMs() + clock_offset_ms_, server_.UnixMs()}; }
  const CoordinatorHost& host() const { return host_; }
  JobRequests& requests() { return requests_; }
  std::shared_ptr<const std::string> FilterInput(const std::string& worker, LeaseId lease) const {
    return desk_.InputOf(host_.Read(
        [&](const Coordinator& c) { return c.FilterTicketOf(worker, lease); }));
  }
  // Whether since the last call a host was banned, connected or not, and what it had touched was
  // dropped, or a job started over with another depth.
  bool FilmsReset() {
    int64_t resets = 0;
    host_.Read([&](const Coordinator& c) {
      resets = c.Totals().banned_hosts;
      for (const v1::Job& record : c.ListJobs(0, SIZE_MAX)) {
        resets += c.ResetsOf(*ParseJobName(record.name()));
      }
    });
    return std::exchange(resets_, resets) != resets;
  }
  uint64_t id() const { return id_; }

  CoordinatorConfig Config() const {
    CoordinatorConfig config;
    config.incarnation = id_;
    config.first_job = server_.platter_.last_job + 1;
    config.version = "sim";
    config.defaults = {.tile_size = 8, .denoisers = {"none"}};
    config.lease_ttl_ms = server_.plan_.lease_ttl_ms;
    config.lease_target_ms = server_.plan_.lease_target_ms;
    config.checkpoint_interval_ms = server_.plan_.checkpoint_ms;
    config.stores_records = server_.plan_.withholds_ends;
    config.build_budget_ms = server_.plan_.build_budget_ms;
    config.audit_rate = server_.plan_.audit_rate;
    config.audit_seed = server_.plan_.seed;
    return config;
  }

 private:
  static absl::Status Dead() { return absl::UnavailableError("the server is dead"); }
  int64_t NowMs() const { return server_.time_.now_us() / kMs; }

  void After(int64_t delay_us, std::function<void()> run) {
    server_.time_.After(delay_us, [self = server_.run_, run = std::move(run)] {
      if (self != nullptr && self->alive_) run();
    });
  }
  // Amid the writing of a film: the rest of the world goes on for a little while.
  void PassTime() {
    if (!alive_) return;
    const int64_t until_us = server_.time_.now_us() + server_.random_.Between(0, 5 * kMs);
    while (alive_ && server_.time_.RunNext(until_us)) {
    }
  }

  std::set<std::string> Liars() const {
    std::set<std::string> hosts;
    for (int i = 0; i < std::ssize(server_.plan_.workers); ++i) {
      if (server_.plan_.workers[static_cast<size_t>(i)].lies > 0) hosts.insert(SimHostName(i));
    }
    return hosts;
  }
  // Whether every job that ends from now on is free of lies.
  bool HasBannedAll() const { return !banned_.empty() && banned_ == Liars(); }

  void On(const SendEffect& e) { server_.network_->WriteDown(e.session, e.message); }
  void On(const CloseSessionEffect& e) {
    server_.trace_(absl::StrCat("closes session ", e.session, ": ", e.status.ToString()));
    server_.network_->Close(e.session, e.status);
  }
  void On(const JobChangedEffect& e) {
    changed_.insert(e.job);
    server_.watch_(e.job);
  }
  void On(const TileChangedEffect&) {}
  void On(const FilterAnswerEffect& e) { desk_.Answer(e); }
  void On(const LeaseExpiredEffect& e) { server_.trace_(LineOf(e)); }
  void On(const RaceBegunEffect& e) { server_.trace_(LineOf(e)); }
  void On(const AuditDiffersEffect& e) { server_.trace_(LineOf(e)); }
  void On(const SaveJobEffect& e) {
    saver_.Save(e.job, e.with_film && server_.plan_.saves_films);
  }
  void On(const BanEffect& e) {
    server_.trace_(absl::StrCat("bans ", e.host));
    saver_.SaveBan(e.host, e.reason);
    banned_.insert(e.host);
    if (!Liars().contains(e.host)) server_.checkers_.Fail(e.host + " is honest, and banned");
  }
  void On(const RemoveJobEffect& e) {
    saver_.Remove(e.job);
    server_.watch_(e.job);
  }
  void On(const EvaluatePictureEffect& e) {
    FilterThen(e.job, [this, job = e.job] {
      const std::shared_ptr<const Film> film =
          host_.Read([&](const Coordinator& c) { return c.FilmOf(job); });
      if (film == nullptr) return;
      std::vector<int64_t> samples;
      for (int64_t tile = 0; tile < film->grid().num_tiles(); ++tile) {
        samples.push_back(film->CommittedEnd(tile));
      }
      const std::vector<double> errors = SimTileErrors(film->grid(), samples);
      const double error = SimError(film->grid(), errors);
      std::vector<CellError> cells;
      for (const double of_cell : errors) cells.push_back({of_cell, of_cell});
      (void)Post(PictureEvent{.job = job,
                              .samples = film->samples(),
                              .estimated_error = std::isfinite(error) ? error : 0,
                              .error_bound = error,
                              .is_refined = true,
                              .cell_errors = std::move(cells)});
      Settle();
    });
  }
  void On(const FinishJobEffect& e) {
    FilterThen(e.job, [this, job = e.job, no_lies = HasBannedAll()] {
      const std::shared_ptr<const Film> film =
          host_.Read([&](const Coordinator& c) { return c.FilmOf(job); });
      if (film == nullptr) return;
      if (no_lies) {
        const auto record = host_.Read([&](const Coordinator& c) { return c.GetJob(job); });
        server_.checkers_.CheckNoLies(*film, *record);
      }
      (void)Post(JobFinishedEvent{job, film->Digest()});
      Settle();
    });
  }

  // What a picture has at workers while it is filtered.
  struct Filtering {
    Filtering(FilterDesk& desk, JobId job) : windows(desk, job) {}
    LeasedWindows windows;
    std::map<PixelRect, SimWindow, PixelRectLess> offered;
    int64_t until_us = 0;  // then the server does itself what has not come
  };

  // Filters the job's picture, then goes on with `then`.
  void FilterThen(JobId job, std::function<void()> then) {
    After(server_.random_.Between(1, 300) * kMs, [this, job, then = std::move(then)] {
      if (!server_.plan_.filters) return then();
      const auto filtering = std::make_shared<Filtering>(desk_, job);
      filtering->until_us = server_.time_.now_us() + server_.random_.Between(0, 4 * kSecond);
      const int64_t room = filtering->windows.Room();
      if (room < 0 || room > 8 * std::ssize(server_.plan_.workers)) {
        server_.checkers_.Fail(absl::StrCat("room for ", room, " windows"));
      }
      // Sometimes more than there is room for: the rest is refused at once.
      const int64_t count = std::min<int64_t>(16, room + server_.random_.Between(0, 2));
      const auto first = static_cast<uint64_t>(server_.random_.Between(0, 1000));
      for (int64_t i = 0; i < count; ++i) {
        SimWindow window = MakeSimWindow(job, first + static_cast<uint64_t>(i));
        FilterOffer offer{.frame = RectOf(window.lease.frame()),
                          .window = RectOf(window.lease.window()),
                          .bounds = RectOf(window.lease.bounds()),
                          .denoiser = window.lease.denoiser(),
                          .quality = window.lease.quality(),
                          .revision = window.lease.revision(),
                          .input = std::make_shared<const std::string>(window.input)};
        filtering->offered[offer.window] = std::move(window);
        filtering->windows.Offer(std::move(offer));
      }
      Await(filtering, then);
    });
  }

  void Await(const std::shared_ptr<Filtering>& filtering, const std::function<void()>& then) {
    for (const LeasedWindows::Answer& answer : filtering->windows.Take()) {
      const auto offered = filtering->offered.extract(answer.window);
      if (offered.empty()) {
        server_.checkers_.Fail("a window was answered twice");
        continue;
      }
      if (answer.planes == nullptr) continue;
      ++server_.windows_filtered_;
      if (SameBits(offered.mapped().filtered, *answer.planes)) continue;
      if (server_.plan_.audit_rate == 0) server_.checkers_.Fail("wrong bits of a filtered window");
      if (!answer.is_audited) continue;
      filtering->windows.ReportLie(answer.host);
      if (FilmsReset()) {
        host_.Read([this](const Coordinator& c) { server_.checkers_.OnReset(c); });
      }
    }
    Settle();
    if (filtering->windows.empty() || server_.time_.now_us() >= filtering->until_us) return then();
    After(50 * kMs, [this, filtering, then] { Await(filtering, then); });
  }

  SimServer& server_;
  const uint64_t id_;
  const int64_t clock_offset_ms_;
  bool alive_ = true;
  Instant last_step_;
  int64_t resets_ = 0;
  std::set<std::string> banned_;  // hosts
  bool saving_ = false;
  bool save_due_ = false;
  std::set<JobId> changed_;
  SimRows rows_;
  SimFilms films_;
  CoordinatorHost host_;
  FilterDesk desk_;
  JobSaver saver_;
  JobRequests requests_;
};

SimServer::SimServer(const FaultPlan& plan, VirtualTime& time, SimRandom& random,
                     Checkers& checkers, Trace trace)
    : plan_(plan),
      time_(time),
      random_(random),
      checkers_(checkers),
      trace_(std::move(trace)),
      assets_(*AssetStore::Open("", 0)) {
  const v1::AssetRef asset = SimAsset();
  (void)assets_->Append(*Sha256FromBytes(asset.sha256()), asset.size_bytes(), 0, kSimAsset);
}

// What still waits in the clock outlives the server, and must not reach it.
SimServer::~SimServer() {
  if (run_ != nullptr) run_->Kill();
}

void SimServer::Start() {
  if (run_ != nullptr) return;
  run_ = std::make_shared<Run>(*this, ++platter_.incarnation);
  std::set<JobId> damaged;
  for (const auto& [job, film] : platter_.films) {
    if (film.damaged) damaged.insert(job);
  }
  trace_(absl::StrCat("starts, incarnation ", run_->id()));
  if (absl::Status status = run_->Restore(); !status.ok()) checkers_.Fail(status.ToString());
  run_->host().Read([&](const Coordinator& c) { checkers_.OnRestored(c, damaged); });
  Settle();
  Tick(run_->id());
}

void SimServer::Crash(int64_t for_us) {
  if (run_ == nullptr) return;
  trace_("is killed");
  checkers_.OnCrash(UnixMs());
  run_->Kill();
  run_.reset();
  network_->ServerDied();
  time_.After(for_us, [this] { Start(); });
}

void SimServer::DiskIsFullFor(int64_t for_us) {
  platter_.is_full = true;
  checkers_.DiskIsFullUntil(UnixMs() + for_us / kMs);
}

void SimServer::Tick(uint64_t run) {
  if (run_ == nullptr || run_->id() != run) return;
  (void)run_->Post(TickEvent{plan_.ingest_load});
  Settle();
  time_.After(100 * kMs, [this, run] { Tick(run); });
}

void SimServer::Settle() {
  if (run_ != nullptr) run_->Settle();
}

void SimServer::Receive(SimNetwork::Stream stream, v1::WorkerMessage message) {
  if (run_ == nullptr) return;
  absl::StatusOr<Event> event = EventOf(stream, message);
  if (!event.ok()) {
    trace_(absl::StrCat("session ", stream, ": ", event.status().ToString()));
    network_->Close(stream, event.status());
    return;
  }
  const auto* const delta = std::get_if<DeltaEvent>(&*event);
  JobId job = 0;
  Unit unit;
  if (delta != nullptr) {
    job = ParseJobName(delta->delta.job()).value_or(0);
    unit = {delta->delta.tile_index(), delta->tile.range()};
  }
  const absl::Status status = run_->Post(*std::move(event));
  if (run_->FilmsReset()) {
    run_->host().Read([this](const Coordinator& c) { checkers_.OnReset(c); });
  } else if (delta != nullptr && status.ok()) {
    checkers_.OnCounted(job, unit);
  }
  Settle();
}

void SimServer::Lost(SimNetwork::Stream stream) {
  if (run_ == nullptr) return;
  (void)run_->Post(WorkerGoneEvent{stream});
  Settle();
}

absl::StatusOr<std::string> SimServer::FilterInput(const std::string& worker, LeaseId lease) {
  if (run_ == nullptr) return absl::UnavailableError("the server is down");
  const std::shared_ptr<const std::string> input = run_->FilterInput(worker, lease);
  if (input == nullptr) return absl::NotFoundError("the lease is gone");
  return *input;
}

uint64_t SimServer::run_id() const { return run_->id(); }
JobRequests& SimServer::requests() { return run_->requests(); }
const CoordinatorHost& SimServer::host() const { return run_->host(); }

}  // namespace tessera
