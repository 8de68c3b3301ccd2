// A coordinator with workers that live in this object: no threads, no clock, every message
// delivered when the test says so.
#pragma once

#include <deque>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "server/coordinator/coordinator.h"
#include "tests/server/synthetic_tile.h"

namespace tessera {

inline constexpr char kArithmetic[] = "00000000000000a1";  // of workers that say no other
inline constexpr char kOtherArithmetic[] = "00000000000000b2";

inline v1::JobSettings SmallSettings(int64_t spp = 16) {
  v1::JobSettings settings;
  settings.set_scene_name("scene.glb");
  v1::AssetRef& asset = *settings.add_assets();
  asset.set_name("scene.glb");
  asset.set_sha256(std::string(32, 'a'));
  asset.set_size_bytes(3);
  settings.set_width(19);
  settings.set_height(10);
  settings.set_spp(spp);
  settings.set_tile_size(8);
  settings.set_max_depth(8);
  settings.set_feature_spp(4);
  return settings;
}

inline CoordinatorConfig SmallConfig() {
  CoordinatorConfig config;
  config.incarnation = 7;
  config.version = "1.2.3";
  config.defaults = {.tile_size = 32, .denoisers = {"none"}};
  config.lease_ttl_ms = 1000;
  return config;
}

inline std::string ExpectedDigest(const v1::JobSettings& s, int64_t spp) {
  const TileGrid grid(RegionOf(s), s.tile_size());
  return ToBytes(SyntheticFilm(s.seed(), grid, spp, FeatureEndOf(s.feature_spp())).Digest());
}

class SimulatedFarm {
 public:
  explicit SimulatedFarm(CoordinatorConfig config = SmallConfig()) : coordinator(config) {}

  struct SimulatedWorker {
    std::deque<v1::Lease> leases;
    std::deque<v1::FilterLease> filters;
    std::map<std::string, v1::JobSettings> specs;
    int welcomes = 0;
    std::vector<std::string> forgotten;
    std::optional<absl::Status> closed;
  };

  // Posts an event and carries out what follows: pictures and last pictures are answered at once.
  StepResult Post(Event event) {
    StepResult result = coordinator.Step(std::move(event), {now_ms, 1000000 + now_ms});
    for (const Effect& effect : result.effects) {
      std::visit([this](const auto& e) { Apply(e); }, effect);
    }
    while (!answers.empty() && answer_pictures) {
      Event answer = std::move(answers.front());
      answers.pop_front();
      Post(std::move(answer));
    }
    return result;
  }

  JobId Create(const v1::JobSettings& settings, const std::string& request_id = "") {
    CreateJobEvent event;
    event.settings = settings;
    event.request_id = request_id;
    return Post(std::move(event)).job;
  }
  absl::Status Command(JobCommand command, JobId job) {
    return Post(JobCommandEvent{command, job, ""}).status;
  }
  v1::Hello MakeHello(const std::string& host, int threads) {
    v1::Hello hello;
    hello.set_host(host);
    hello.set_process_id(1);
    hello.set_threads(threads);
    hello.set_memory_bytes(int64_t{1} << 30);
    hello.set_version("1.2.3");
    hello.add_isa_classes("x86-64-v3");
    hello.add_arithmetic(kArithmetic);
    return hello;
  }
  SessionId Connect(int threads = 2, const std::string& host = "",
                    int64_t memory_bytes = int64_t{1} << 30) {
    const SessionId session = next_session++;
    v1::Hello hello = MakeHello(host.empty() ? absl::StrCat("host", session) : host, threads);
    hello.set_memory_bytes(memory_bytes);
    Post(WorkerConnectedEvent{session, std::move(hello)});
    return session;
  }
  // As Connect, of the process that follows one that crashed.
  SessionId ConnectAfter(const v1::CrashReport& crash, const std::string& host, int threads = 2) {
    const SessionId session = next_session++;
    v1::Hello hello = MakeHello(host, threads);
    *hello.add_crashes() = crash;
    Post(WorkerConnectedEvent{session, std::move(hello)});
    return session;
  }
  void Disconnect(SessionId session) {
    workers.erase(session);
    Post(WorkerGoneEvent{session});
  }

  // The worker renders all its leases, and has done so many samples of each.
  void Heartbeat(SessionId session, int64_t samples) {
    HeartbeatEvent event{session};
    for (const v1::Lease& lease : workers[session].leases) {
      v1::LeaseProgress& progress = event.leases.emplace_back();
      progress.set_id(lease.id());
      progress.set_state(v1::LeaseProgress::STATE_RENDERING);
      progress.set_samples(samples);
    }
    Post(std::move(event));
  }

  // What the worker sends once it has rendered the lease.
  DeltaEvent Render(SessionId session, const v1::Lease& lease) {
    DeltaEvent event;
    event.session = session;
    event.delta.set_lease_id(lease.id());
    event.delta.set_job(lease.job());
    event.delta.set_tile_index(lease.tile_index());
    event.delta.set_rays(5);
    event.delta.set_max_depth(pilot_depths.contains(session) ? pilot_depths[session] : 6);
    event.wire_bytes = 100;
    const v1::JobSettings& spec = workers[session].specs[lease.job()];
    event.tile = render_tile(spec.seed(), RectOf(lease.window()),
                             {lease.sample_begin(), lease.sample_end()},
                             FeatureEndOf(spec.feature_spp()));
    return event;
  }
  // The worker finishes its oldest lease. Returns false if it has none.
  bool RenderOne(SessionId session) {
    SimulatedWorker& worker = workers[session];
    if (worker.leases.empty()) return false;
    const v1::Lease lease = worker.leases.front();
    worker.leases.pop_front();
    last_status = Post(Render(session, lease)).status;
    return true;
  }
  // All workers render in turn until nobody has a lease.
  void RunAll() {
    for (bool any = true; any;) {
      any = false;
      for (SessionId session = 1; session < next_session; ++session) {
        if (workers.contains(session) && RenderOne(session)) any = true;
      }
    }
  }
  v1::Job Job(JobId id) { return *coordinator.GetJob(id); }

  Coordinator coordinator;
  int64_t now_ms = 1000;
  SessionId next_session = 1;
  std::map<SessionId, SimulatedWorker> workers;
  std::deque<Event> answers;
  bool answer_pictures = true;
  double estimated_error = 0.5;  // what evaluated pictures say
  // And of their tiles, asked before: by default that all are equally bad.
  std::function<std::vector<CellError>(const Film&)> cell_errors = [](const Film& film) {
    return std::vector<CellError>(static_cast<size_t>(film.grid().num_tiles()), {1, 1});
  };
  // What the workers render.
  std::function<TileStatistics(uint64_t seed, const PixelRect& window, SampleRange range,
                               int64_t feature_end)>
      render_tile = SyntheticTile;
  std::vector<JobId> removed, saved;
  std::vector<std::string> bans;
  std::vector<LeaseExpiredEffect> expired;
  std::vector<RaceBegunEffect> races;
  std::vector<AuditDiffersEffect> differences;
  std::vector<FilterAnswerEffect> filter_answers;
  absl::Status last_status;
  std::map<SessionId, int> pilot_depths;  // that workers find for jobs with auto_depth; else 6

 private:
  void Apply(const SendEffect& effect) {
    SimulatedWorker& worker = workers[effect.session];
    const v1::CoordinatorMessage& message = effect.message;
    if (message.has_welcome()) ++worker.welcomes;
    if (message.has_job()) worker.specs[message.job().job()] = message.job().settings();
    if (message.has_lease()) worker.leases.push_back(message.lease());
    if (message.has_filter()) worker.filters.push_back(message.filter());
    if (message.has_forget()) worker.forgotten.push_back(message.forget().job());
    if (message.has_revoke()) {
      const auto is_revoked = [id = message.revoke().id()](const auto& l) { return l.id() == id; };
      std::erase_if(worker.leases, is_revoked);
      std::erase_if(worker.filters, is_revoked);
    }
  }
  void Apply(const CloseSessionEffect& effect) {
    workers[effect.session].closed = effect.status;
    workers[effect.session].leases.clear();
  }
  void Apply(const JobChangedEffect&) {}
  void Apply(const TileChangedEffect&) {}
  void Apply(const SaveJobEffect& effect) { saved.push_back(effect.job); }
  void Apply(const BanEffect& effect) { bans.push_back(effect.host); }
  void Apply(const RemoveJobEffect& effect) { removed.push_back(effect.job); }
  void Apply(const FilterAnswerEffect& effect) { filter_answers.push_back(effect); }
  void Apply(const LeaseExpiredEffect& effect) { expired.push_back(effect); }
  void Apply(const RaceBegunEffect& effect) { races.push_back(effect); }
  void Apply(const AuditDiffersEffect& effect) { differences.push_back(effect); }
  void Apply(const EvaluatePictureEffect& effect) {
    const v1::Job job = *coordinator.GetJob(effect.job);
    PictureEvent picture{
        .job = effect.job, .samples = job.progress().samples(), .is_refined = true};
    if (IsAdaptive(job.settings())) {
      picture.cell_errors = cell_errors(*coordinator.FilmOf(effect.job));
    }
    picture.estimated_error = picture.error_bound = estimated_error;
    answers.push_back(std::move(picture));
  }
  void Apply(const FinishJobEffect& effect) {
    answers.push_back(JobFinishedEvent{effect.job, coordinator.FilmOf(effect.job)->Digest()});
  }
};

}  // namespace tessera
