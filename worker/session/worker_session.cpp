#include "worker/session/worker_session.h"

#include <unistd.h>

#include <chrono>
#include <condition_variable>
#include <cstdlib>
#include <deque>
#include <map>
#include <mutex>
#include <optional>
#include <utility>

#include "core/base/version.h"
#include "worker/integrator/arithmetic.h"
#include "worker/session/asset_fetcher.h"
#include "worker/session/filter_input_reader.h"
#include "worker/session/host_resources.h"
#include "worker/session/path_tracer_renderer.h"
#include "worker/session/render_pool.h"
#include "worker/session/scene_builder.h"
#include "worker/session/session_machine.h"
#include "worker/session/window_filter.h"
#include "worker/session/work_stream.h"

namespace tessera {
namespace {

WorkerOptions WithDefaults(WorkerOptions options) {
  if (options.threads <= 0) options.threads = MachineThreads();
  if (options.memory_bytes <= 0) options.memory_bytes = MachineMemoryBytes() / 2;
  if (options.name.empty()) options.name = MachineName();
  return options;
}

// Spreads reconnects of workers that lost one server; decides nothing else.
uint64_t JitterSeed() {
  return static_cast<uint64_t>(getpid()) * 0x9e3779b97f4a7c15u ^
         static_cast<uint64_t>(std::chrono::steady_clock::now().time_since_epoch().count());
}

SessionOptions MachineOptions(const WorkerOptions& options, uint64_t jitter_seed,
                              std::function<int64_t(uint64_t)> samples_of) {
  SessionOptions session;
  session.samples_of = std::move(samples_of);
  session.threads = options.threads;
  session.memory_bytes = options.memory_bytes;
  session.connect_attempts_max = options.connect_attempts_max;
  session.jitter_seed = jitter_seed;
  session.hello.set_host(options.name);
  session.hello.set_process_id(getpid());
  session.hello.set_threads(options.threads);
  session.hello.set_memory_bytes(options.memory_bytes);
  session.hello.set_version(kVersion);
  for (const std::string& isa : SupportedIsaClasses()) {
    session.hello.add_isa_classes(isa);
    session.hello.add_arithmetic(ArithmeticOf(isa));
  }
  session.hello.set_same_process(options.same_process);
  session.hello.set_filters(!options.same_process);  // on the same cores it would gain nothing
  for (const v1::CrashReport& crash : options.crashes) *session.hello.add_crashes() = crash;
  return session;
}

}  // namespace

class WorkerSession::Impl {
 public:
  Impl(std::shared_ptr<grpc::Channel> channel, const WorkerOptions& options,
       std::unique_ptr<RendererFactory> factory)
      : options_(WithDefaults(options)),
        jitter_seed_(JitterSeed()),
        stub_(v1::WorkerService::NewStub(channel)),
        factory_(std::move(factory)),
        fetcher_(channel, options_.cache_bytes, jitter_seed_),
        filter_inputs_(channel),
        machine_(MachineOptions(options_, jitter_seed_,
                                [this](uint64_t task) { return pool_->SamplesOf(task); })) {}

  absl::Status Run();

  void Post(SessionEvent event) {
    {
      std::lock_guard lock(mu_);
      events_.push_back(std::move(event));
    }
    cv_.notify_one();
  }

 private:
  // The next event, or Timer when the machine's timer is due.
  SessionEvent NextEvent();
  void OnBuilt(const std::string& scene, BuildOutcome outcome,
               std::shared_ptr<const Renderer> renderer);

  void Apply(session_effect::OpenStream&);
  void Apply(session_effect::Write& effect) { stream_->Write(std::move(effect.message)); }
  void Apply(session_effect::HalfClose&) { stream_->HalfClose(); }
  void Apply(session_effect::AbortStream&) { stream_->Abort(); }
  void Apply(session_effect::BuildScene& effect);
  void Apply(session_effect::CancelBuild&) { builder_->Cancel(); }
  void Apply(session_effect::DropScene& effect);
  void Apply(session_effect::StartRender& effect);
  void Apply(session_effect::StartFilter& effect);
  void Apply(session_effect::CancelRender& effect) {
    pool_->Cancel(effect.task);
    filter_inputs_.Cancel(effect.task);
  }
  void Apply(session_effect::GiveUp& effect);
  void Apply(session_effect::Log& effect) {
    if (options_.log) options_.log(effect.level, effect.line);
  }
  void Apply(session_effect::Finish& effect) { result_ = std::move(effect.status); }

  const WorkerOptions options_;
  const uint64_t jitter_seed_;
  std::unique_ptr<v1::WorkerService::Stub> stub_;
  std::unique_ptr<RendererFactory> factory_;
  AssetFetcher fetcher_;
  FilterInputReader filter_inputs_;
  SessionMachine machine_;              // Run's thread only
  std::optional<absl::Status> result_;  // Run's thread only

  std::mutex mu_;
  std::condition_variable cv_;
  std::deque<SessionEvent> events_;  // guarded by mu_
  // Guarded by mu_. Shared with the tasks that render them: a scene may be dropped before a
  // cancelled task has noticed.
  std::map<std::string, std::shared_ptr<const Renderer>> scenes_;

  // Alive during Run; destroyed first, so that nobody posts to what is gone.
  std::unique_ptr<RenderPool> pool_;
  std::unique_ptr<SceneBuilder> builder_;
  std::unique_ptr<WorkStream> stream_;
};

absl::Status WorkerSession::Impl::Run() {
  const DeltaEncoding encoding =
      options_.same_process ? DeltaEncoding::kPacked : DeltaEncoding::kPackedBlocks;
  pool_ = std::make_unique<RenderPool>(options_.threads, encoding, options_.journal,
                                       [this](uint64_t task, absl::StatusOr<v1::TileDelta> delta) {
                                         Post(session_event::Rendered{task, std::move(delta)});
                                       });
  builder_ =
      std::make_unique<SceneBuilder>(*factory_, fetcher_, options_.memory_bytes, options_.threads,
                                     options_.journal,
                                     [this](const std::string& scene, BuildOutcome outcome,
                                            std::shared_ptr<const Renderer> renderer) {
                                       OnBuilt(scene, std::move(outcome), std::move(renderer));
                                     });

  SessionEvent event = session_event::Start{};
  while (!result_) {
    std::vector<SessionEffect> effects =
        machine_.Step(std::move(event), std::chrono::steady_clock::now());
    for (SessionEffect& effect : effects) {
      std::visit([this](auto& e) { Apply(e); }, effect);
    }
    if (!result_) event = NextEvent();
  }
  stream_.reset();
  filter_inputs_.Stop();
  pool_.reset();
  builder_.reset();
  return *result_;
}

SessionEvent WorkerSession::Impl::NextEvent() {
  const std::optional<SessionTime> timer = machine_.NextTimer();
  std::unique_lock lock(mu_);
  const auto ready = [this] { return !events_.empty(); };
  if (timer) {
    if (!cv_.wait_until(lock, *timer, ready)) return session_event::Timer{};
  } else {
    cv_.wait(lock, ready);
  }
  SessionEvent event = std::move(events_.front());
  events_.pop_front();
  return event;
}

void WorkerSession::Impl::OnBuilt(const std::string& scene, BuildOutcome outcome,
                                  std::shared_ptr<const Renderer> renderer) {
  if (renderer) {
    std::lock_guard lock(mu_);
    scenes_[scene] = std::move(renderer);
  }
  Post(session_event::SceneBuilt{scene, std::move(outcome)});
}

void WorkerSession::Impl::Apply(session_effect::OpenStream&) {
  stream_.reset();
  stream_ = std::make_unique<WorkStream>(*stub_, [this](SessionEvent e) { Post(std::move(e)); });
}

void WorkerSession::Impl::Apply(session_effect::BuildScene& effect) {
  builder_->Build(effect.scene, effect.job, effect.settings);
}

void WorkerSession::Impl::Apply(session_effect::DropScene& effect) {
  std::shared_ptr<const Renderer> dropped;  // freed after the lock
  std::lock_guard lock(mu_);
  if (const auto scene = scenes_.find(effect.scene); scene != scenes_.end()) {
    dropped = std::move(scene->second);
    scenes_.erase(scene);
  }
}

void WorkerSession::Impl::Apply(session_effect::GiveUp& effect) {
  if (options_.log) options_.log(LogLevel::kWarning, effect.why);
  // What supervises the process starts another, which reports what hung.
  if (options_.journal != nullptr) std::abort();
}

void WorkerSession::Impl::Apply(session_effect::StartRender& effect) {
  std::shared_ptr<const Renderer> renderer;
  {
    std::lock_guard lock(mu_);
    renderer = scenes_.at(effect.scene);
  }
  pool_->Start(effect.task, std::move(renderer), effect.lease);
}

void WorkerSession::Impl::Apply(session_effect::StartFilter& effect) {
  pool_->Start(effect.task, [this, task = effect.task, worker = std::move(effect.worker),
                             lease = std::move(effect.lease)](const std::atomic<bool>& cancelled,
                                                              std::atomic<int64_t>* parts_done) {
    session_event::Filtered filtered{.task = task};
    absl::StatusOr<std::string> input = absl::CancelledError("cancelled before it began");
    if (!cancelled) input = filter_inputs_.Read(task, worker, lease);
    if (input.ok()) {
      filtered.filtered = FilterWindow(lease, *input, cancelled, parts_done);
    } else {
      filtered.filtered = input.status();
    }
    Post(std::move(filtered));
  });
}

WorkerSession::WorkerSession(std::shared_ptr<grpc::Channel> channel, const WorkerOptions& options)
    : WorkerSession(std::move(channel), options, MakePathTracerFactory()) {}

WorkerSession::WorkerSession(std::shared_ptr<grpc::Channel> channel, const WorkerOptions& options,
                             std::unique_ptr<RendererFactory> factory)
    : impl_(std::make_unique<Impl>(std::move(channel), options, std::move(factory))) {}

WorkerSession::~WorkerSession() = default;

absl::Status WorkerSession::Run() { return impl_->Run(); }
void WorkerSession::Drain() { impl_->Post(session_event::DrainRequested{}); }
void WorkerSession::Stop() { impl_->Post(session_event::StopRequested{}); }

}  // namespace tessera
