#include "server/service.h"

#include <algorithm>
#include <atomic>
#include <random>
#include <thread>

#include <grpcpp/ext/proto_server_reflection_plugin.h>
#include <grpcpp/grpcpp.h>
#include <grpcpp/health_check_service_interface.h>
#include <unistd.h>

#include "absl/strings/str_cat.h"
#include "core/base/version.h"
#include "proto/channel/server_address.h"
#include "server/coordinator/limits.h"
#include "server/coordinator_host.h"
#include "server/event_log.h"
#include "server/http/http_server.h"
#include "server/job_saver.h"
#include "server/log.h"
#include "server/memory/large_blocks.h"
#include "server/picture/filter_desk.h"
#include "server/picture/picture_service.h"
#include "server/restore.h"
#include "server/rpc/asset_service.h"
#include "server/rpc/image_service.h"
#include "server/rpc/job_service.h"
#include "server/rpc/client_limits.h"
#include "server/rpc/watch_hub.h"
#include "server/rpc/worker_service.h"
#include "server/rpc/worker_sessions.h"
#include "server/rpc/write_deadlines.h"
#include "server/security/access.h"
#include "server/store/catalogue.h"
#include "server/store/data_dir.h"
#include "server/store/film_store.h"

namespace tessera {
namespace {

constexpr std::chrono::milliseconds kPumpInterval{20};
constexpr int kPumpsPerTick = 5;
constexpr int kPingIntervalMinMs = 5000;
constexpr int kKeepaliveMs = 20000;
constexpr int kKeepaliveTimeoutMs = 10000;
constexpr std::chrono::milliseconds kShutdownGrace{1000};
constexpr char kHttpOff[] = "off";

absl::Status CheckOptions(const ServiceOptions& options) {
  for (const std::string& address : {options.listen, options.http_listen}) {
    if (!address.empty() && address != kHttpOff && !IsLoopback(address) &&
        !options.tls.enabled() && !options.insecure) {
      return absl::InvalidArgumentError(absl::StrCat(
          "plaintext on ", address, " could be read by anyone: give --tls-cert and --tls-key, "
          "listen on 127.0.0.1, or say --insecure if the network is yours"));
    }
  }
  if (options.tile_size < 1 || options.tile_size > kTileSizeMaxPx) {
    return absl::InvalidArgumentError(
        absl::StrCat("tile_size is ", options.tile_size, ": give 1 to ", kTileSizeMaxPx));
  }
  if (options.data_bytes_max < 0) {
    return absl::InvalidArgumentError("--quota is negative: give bytes, or 0 for no limit");
  }
  if (options.lease_ttl.count() < 100 || options.lease_ttl.count() > 3600000) {
    return absl::InvalidArgumentError(absl::StrCat(
        "--lease-ttl is ", options.lease_ttl.count(), " ms: give 100 ms to an hour"));
  }
  if (!(options.audit_rate >= 0 && options.audit_rate <= 1)) {
    return absl::InvalidArgumentError("--audit-rate: give 0 (none) to 1 (every unit)");
  }
  if (options.build_budget.count() < 1000 || options.write_deadline.count() < 100) {
    return absl::InvalidArgumentError(
        "--build-budget: give a second or more; --write-deadline: a tenth or more");
  }
  const ClientLimitOptions& limits = options.client_limits;
  for (const int64_t limit : {limits.jobs, limits.pixels, limits.samples, limits.asset_bytes,
                              limits.streams}) {
    if (limit < 0) {
      return absl::InvalidArgumentError("--client-...: a limit is negative: give 0 for none");
    }
  }
  if (options.filter_threads < 0 || options.filter_threads > 1024) {
    return absl::InvalidArgumentError("--filter-threads: give 1 to 1024, or 0 for all");
  }
  return absl::OkStatus();
}

// With --filter-on workers only those that hang or are lost are not waited for.
constexpr double kFilterPatienceSeconds = 20;

int64_t HalfOfMemory() {
  return int64_t{sysconf(_SC_PHYS_PAGES)} * sysconf(_SC_PAGESIZE) / 2;
}

}  // namespace

class Service::Impl : public EffectSink {
 public:
  absl::Status Start(const ServiceOptions& options);
  void Shutdown();
  void Apply(const Effect& effect) override;

  int port_ = 0;
  std::unique_ptr<grpc::Server> server_;
  std::unique_ptr<HttpServer> http_;

 private:
  absl::Status OpenStore(const ServiceOptions& options);
  void MakeServices(const ServiceOptions& options);
  void NoteJobsOfClients();  // of earlier runs, as far as tokens tell whose they are
  absl::Status Listen(const ServiceOptions& options);
  // The job's film, from memory or disk. Errors: NOT_FOUND (the job), DATA_LOSS.
  absl::StatusOr<std::shared_ptr<const Film>> FilmOf(JobId job);
  PictureSource MakePictureSource();

  // The share of the time since the last call in which deltas were decoded, on all cores, or the
  // coordinator was busy; whichever is greater.
  double IngestLoad();

  void On(const SendEffect& e) {
    LogSent(e);
    sessions_->Send(e.session, e.message);
  }
  void On(const CloseSessionEffect& e) { sessions_->End(e.session, e.status); }
  void On(const JobChangedEffect& e) { watchers_->Notify(e.job); }
  void On(const TileChangedEffect& e) { pictures_->TileChanged(e.job, e.tile); }
  void On(const SaveJobEffect& e) { saver_->Save(e.job, e.with_film); }
  void On(const BanEffect& e) {
    ServerLog().warn("host={} is banned: {}", e.host, e.reason);
    saver_->SaveBan(e.host, e.reason);
    pictures_->Distrust(e.host);  // what it has filtered is filtered again
  }
  void On(const RemoveJobEffect& e) {
    saver_->Remove(e.job);
    pictures_->Remove(e.job);
    watchers_->Notify(e.job);
  }
  void On(const EvaluatePictureEffect& e) { pictures_->Evaluate(e.job); }
  void On(const FinishJobEffect& e) { pictures_->Finish(e.job); }
  void On(const FilterAnswerEffect& e) { desk_->Answer(e); }
  void On(const LeaseExpiredEffect& e) { ServerLog().warn("{}", LineOf(e)); }
  void On(const RaceBegunEffect& e) { LogRace(e); }
  void On(const AuditDiffersEffect& e) { ServerLog().warn("{}", LineOf(e)); }

  // Declared in the order in which they are made; destroyed in reverse.
  std::unique_ptr<DataDir> data_dir_;
  std::unique_ptr<AssetStore> assets_;
  std::unique_ptr<Catalogue> catalogue_;  // null without a data_dir
  std::unique_ptr<FilmStore> films_;      // null without a data_dir
  CoordinatorConfig config_;
  std::unique_ptr<JobSaver> saver_;
  std::unique_ptr<WorkerSessions> sessions_;
  std::unique_ptr<WatchHub> watchers_;
  Access access_;
  std::unique_ptr<ClientLimits> limits_;
  std::unique_ptr<WriteDeadlines> deadlines_;
  std::unique_ptr<CoordinatorHost> host_;
  std::unique_ptr<FilterDesk> desk_;
  std::unique_ptr<PictureService> pictures_;
  std::unique_ptr<JobService> job_service_;
  std::unique_ptr<AssetService> asset_service_;
  std::unique_ptr<ImageService> image_service_;
  std::unique_ptr<WorkerService> worker_service_;
  std::atomic<bool> stopping_{false};
  std::thread pump_;
  int64_t load_at_ms_ = 0;  // pump_ only
};

void Service::Impl::Apply(const Effect& effect) {
  std::visit([this](const auto& e) { On(e); }, effect);
}

absl::Status Service::Impl::OpenStore(const ServiceOptions& options) {
  if (!options.data_dir.empty()) {
    absl::StatusOr<std::unique_ptr<DataDir>> data_dir = DataDir::Open(options.data_dir);
    if (!data_dir.ok()) return data_dir.status();
    data_dir_ = *std::move(data_dir);
    auto catalogue = Catalogue::Open(data_dir_->Path("jobs.sqlite"));
    if (!catalogue.ok()) return catalogue.status();
    catalogue_ = *std::move(catalogue);
    auto films = FilmStore::Open(data_dir_->Path("films"));
    if (!films.ok()) return films.status();
    films_ = *std::move(films);
    if (options.forget_bans) {
      if (absl::Status status = catalogue_->ForgetBans(); !status.ok()) return status;
    }
    const absl::StatusOr<uint64_t> incarnation = catalogue_->NextIncarnation();
    if (!incarnation.ok()) return incarnation.status();
    config_.incarnation = *incarnation;
    const absl::StatusOr<uint64_t> last_job = catalogue_->LastJob();
    if (!last_job.ok()) return last_job.status();
    config_.first_job = *last_job + 1;
  } else {
    config_.incarnation = static_cast<uint64_t>(Now().unix_ms);
  }
  int64_t bytes_max = options.data_bytes_max;
  if (!data_dir_ && (bytes_max == 0 || bytes_max > HalfOfMemory())) bytes_max = HalfOfMemory();
  auto assets = AssetStore::Open(data_dir_ ? data_dir_->Path("assets") : "", bytes_max);
  if (!assets.ok()) return assets.status();
  assets_ = *std::move(assets);
  if (films_) assets_->ShareQuotaWith([this] { return films_->bytes(); });
  return absl::OkStatus();
}

absl::StatusOr<std::shared_ptr<const Film>> Service::Impl::FilmOf(JobId job) {
  std::shared_ptr<const Film> film;
  const absl::StatusOr<v1::Job> record = host_->Read([&](const Coordinator& c) {
    film = c.FilmOf(job);
    return c.GetJob(job);
  });
  if (!record.ok()) return record.status();
  if (film != nullptr) return film;
  const Film empty = EmptyFilmOf(record->settings());
  if (record->progress().samples() == 0) return std::make_shared<const Film>(empty);
  absl::StatusOr<StoredFilm> stored = films_->Load(job, empty.grid(), empty.feature_end());
  if (stored.ok()) return std::move(stored->film);
  ServerLog().error("job={} {}", job, std::string(stored.status().message()));
  return absl::DataLossError(
      absl::StrCat("the film of ", JobName(job), " on the server's disk is damaged or missing: its "
                   "samples are lost, submit it anew"));
}

PictureSource Service::Impl::MakePictureSource() {
  PictureSource source;
  source.view = [this](JobId job) -> std::unique_ptr<PictureSource::JobView> {
    PictureSource::JobView view;
    const bool exists = host_->Read([&](const Coordinator& c) {
      const absl::StatusOr<v1::Job> record = c.GetJob(job);
      if (!record.ok()) return false;
      const bool is_sampling = record->state() == v1::JOB_STATE_QUEUED ||
                               record->state() == v1::JOB_STATE_RUNNING;
      view = {record->settings(), record->progress().samples(), is_sampling, c.FilmOf(job),
              record->progress().samples() > 0};
      return true;
    });
    if (exists && view.film == nullptr) {
      if (auto film = FilmOf(job); film.ok()) view.film = *std::move(film);
    }
    if (view.film == nullptr) return nullptr;
    return std::make_unique<PictureSource::JobView>(std::move(view));
  };
  source.fold_tile = [this](const Film& film, int64_t tile) {
    return host_->Read([&](const Coordinator&) { return film.Fold(tile); });
  };
  source.on_picture = [this](const PictureEvent& event) { host_->Post(event); };
  source.on_finished = [this](const JobFinishedEvent& event) {
    ServerLog().info("job={} finished digest={}", event.job, ToHex(event.digest));
    host_->Post(event);
  };
  return source;
}

double Service::Impl::IngestLoad() {
  const int64_t now_ms = Now().monotonic_ms;
  const double elapsed_ns =
      1e6 * static_cast<double>(now_ms - std::exchange(load_at_ms_, now_ms));
  const double cores = std::max(1u, std::thread::hardware_concurrency());
  const double busy_ns = std::max(static_cast<double>(host_->TakeBusyNs()),
                                  static_cast<double>(sessions_->TakeDecodeNs()) / cores);
  return elapsed_ns > 0 ? busy_ns / elapsed_ns : 0;
}

void Service::Impl::MakeServices(const ServiceOptions& options) {
  config_.version = kVersion;
  config_.defaults = {.tile_size = options.tile_size, .denoisers = DenoiserNames()};
  config_.lease_ttl_ms = options.lease_ttl.count();
  config_.build_budget_ms = options.build_budget.count();
  config_.audit_rate = options.audit_rate;
  std::random_device secret;  // decides who checks what, never a bit
  config_.audit_seed = uint64_t{secret()} << 32 | secret();
  config_.stores_records = catalogue_ != nullptr;
  config_.film_bytes_max = HalfOfMemory();
  saver_ = std::make_unique<JobSaver>(catalogue_.get(), films_.get(), assets_.get());
  sessions_ = std::make_unique<WorkerSessions>([this](Event event) {
    const auto* const delta = std::get_if<DeltaEvent>(&event);
    std::string line;
    if (delta != nullptr && ServerLog().should_log(spdlog::level::debug)) line = LineOf(*delta);
    const absl::Status status = host_->Post(std::move(event)).status;
    if (!line.empty()) {
      LogDelta(line, status);
    } else if (!status.ok()) {
      ServerLog().debug("worker event: {}", status.ToString());
    }
  }, options.audit_rate > 0, [this](JobId job, int64_t tile_index, SampleRange range) {
    return host_->TryRead([&](const Coordinator& c) {
      const std::shared_ptr<const Film> film = c.FilmOf(job);
      return film == nullptr ? FoldTarget{} : FoldTargetIn(*film, tile_index, range);
    });
  });
  watchers_ = std::make_unique<WatchHub>(WatchCallbacks{
      .get_job =
          [this](JobId job, v1::Job* out) {
            absl::StatusOr<v1::Job> record =
                host_->Read([&](const Coordinator& c) { return c.GetJob(job); });
            if (!record.ok()) return false;
            *out = *std::move(record);
            return true;
          },
      .added = [this](JobId job, const auto& region) { pictures_->AddWatcher(job, region); },
      .removed = [this](JobId job, const auto& region) {
        pictures_->RemoveWatcher(job, region);
      }});
  host_ = std::make_unique<CoordinatorHost>(config_, *this);
  // Of a server without a port the only client is the program around it.
  limits_ = std::make_unique<ClientLimits>(
      options.listen.empty() ? ClientLimitOptions{0, 0, 0, 0, 0} : options.client_limits,
      [this](JobId job) {
        return host_->Read([&](const Coordinator& c) { return c.IsUnfinished(job); });
      });
  deadlines_ = std::make_unique<WriteDeadlines>(options.write_deadline.count());
  const int cores = static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
  desk_ = std::make_unique<FilterDesk>(
      FilterDeskOptions{options.filter_on, options.audit_rate, config_.audit_seed,
                        options.filter_on == FilterOn::kWorkers ? kFilterPatienceSeconds : 0},
      [this](Event event) { host_->Post(std::move(event)); },
      [this](JobId job) {
        return host_->Read([&](const Coordinator& c) { return c.FilterRoom(job, Now()); });
      });
  pictures_ = std::make_unique<PictureService>(
      MakePictureSource(), options.filter_threads > 0 ? options.filter_threads : cores,
      desk_.get());
  job_service_ =
      std::make_unique<JobService>(*host_, *assets_, *watchers_, config_.defaults,
                                   JobKeeper{[this](JobId job) { return saver_->SaveNow(job); },
                                             [this](JobId job) { return saver_->RemoveNow(job); }},
                                   access_, *limits_, *deadlines_);
  asset_service_ = std::make_unique<AssetService>(*assets_, access_, *limits_, *deadlines_);
  image_service_ = std::make_unique<ImageService>(
      *host_, *pictures_, [this](JobId job) { return FilmOf(job); }, access_, *limits_,
      *deadlines_);
  worker_service_ = std::make_unique<WorkerService>(*host_, *sessions_, *desk_, access_);
  saver_->Start(host_.get());
}

void Service::Impl::NoteJobsOfClients() {
  const auto jobs = host_->Read([](const Coordinator& c) { return c.ListJobs(0, SIZE_MAX); });
  for (const v1::Job& job : jobs) {
    if (job.owner().empty()) continue;
    limits_->Created(ClientOf(Caller{.name = job.owner()}, ""), *ParseJobName(job.name()),
                     job.settings());
  }
}

absl::Status Service::Impl::Listen(const ServiceOptions& options) {
  const auto credentials = MakeServerCredentials(options.tls);
  if (!credentials.ok()) return credentials.status();
  grpc::EnableDefaultHealthCheckService(true);
  grpc::reflection::InitProtoReflectionServerBuilderPlugin();
  grpc::ServerBuilder builder;
  builder.SetMaxReceiveMessageSize(kMessageBytesMax);
  builder.AddChannelArgument(GRPC_ARG_ALLOW_REUSEPORT, 0);
  builder.AddChannelArgument(GRPC_ARG_MAX_CONCURRENT_STREAMS, kStreamsOfConnectionMax);
  builder.AddChannelArgument(GRPC_ARG_HTTP2_MIN_RECV_PING_INTERVAL_WITHOUT_DATA_MS,
                             kPingIntervalMinMs);
  builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_PERMIT_WITHOUT_CALLS, 1);
  builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIME_MS, kKeepaliveMs);
  builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, kKeepaliveTimeoutMs);
  if (!options.listen.empty()) {
    builder.AddListeningPort(options.listen, *credentials, &port_);
  }
  builder.RegisterService(job_service_.get());
  builder.RegisterService(asset_service_.get());
  builder.RegisterService(image_service_.get());
  builder.RegisterService(worker_service_.get());
  server_ = builder.BuildAndStart();
  if (server_ == nullptr || (!options.listen.empty() && port_ == 0)) {
    return absl::UnavailableError(absl::StrCat(
        "cannot listen on ", options.listen, ": the address is in use or not this machine's; "
        "choose another --listen"));
  }
  if (options.http_listen.empty() || options.http_listen == kHttpOff) return absl::OkStatus();
  absl::StatusOr<std::unique_ptr<HttpServer>> http =
      HttpServer::Start(options.http_listen, options.tls, *host_, *pictures_, access_);
  if (!http.ok()) return http.status();
  http_ = *std::move(http);
  return absl::OkStatus();
}

absl::Status Service::Impl::Start(const ServiceOptions& options) {
  if (absl::Status status = CheckOptions(options); !status.ok()) return status;
  absl::StatusOr<Access> access = Access::Open(options.token_file, !options.tls.client_ca.empty());
  if (!access.ok()) return access.status();
  access_ = *std::move(access);
  if (absl::Status status = OpenStore(options); !status.ok()) return status;
  MakeServices(options);
  if (catalogue_ != nullptr) {
    const absl::Status status =
        RestoreJobs(*catalogue_, *films_, *assets_, config_.defaults, *host_);
    if (!status.ok()) return status;
    NoteJobsOfClients();
  }
  if (absl::Status status = Listen(options); !status.ok()) return status;
  pump_ = std::thread([this] {
    for (int i = 0; !stopping_; ++i) {
      std::this_thread::sleep_for(kPumpInterval);
      watchers_->Pump();
      if (i % kPumpsPerTick != 0) continue;
      sessions_->Pump(Now().monotonic_ms);
      if (const int cut = deadlines_->Pump(Now().monotonic_ms); cut > 0) {
        ServerLog().warn("{} streams cancelled: their clients do not read (--write-deadline)", cut);
      }
      host_->Post(TickEvent{IngestLoad()});
      TrimLargeBlocks();
    }
  });
  return absl::OkStatus();
}

void Service::Impl::Shutdown() {
  if (stopping_.exchange(true)) return;
  if (pump_.joinable()) pump_.join();
  if (http_) http_->Stop();
  if (watchers_) watchers_->Close();
  if (sessions_) sessions_->Close();
  if (pictures_) pictures_->Stop();
  if (server_) {
    server_->Shutdown(std::chrono::system_clock::now() + kShutdownGrace);
    server_->Wait();
  }
  if (saver_) saver_->Stop();
}

absl::StatusOr<std::unique_ptr<Service>> Service::Start(const ServiceOptions& options) {
  auto impl = std::make_unique<Impl>();
  if (absl::Status status = impl->Start(options); !status.ok()) {
    impl->Shutdown();
    return status;
  }
  return std::unique_ptr<Service>(new Service(std::move(impl)));
}

Service::Service(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Service::~Service() { Shutdown(); }

int Service::port() const { return impl_->port_; }
int Service::http_port() const { return impl_->http_ ? impl_->http_->port() : 0; }

std::shared_ptr<grpc::Channel> Service::InProcessChannel() {
  grpc::ChannelArguments arguments;
  arguments.SetMaxReceiveMessageSize(kMessageBytesMax);
  return impl_->server_->InProcessChannel(arguments);
}

void Service::Shutdown() { impl_->Shutdown(); }

}  // namespace tessera
