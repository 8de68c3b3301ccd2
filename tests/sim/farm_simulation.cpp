#include "tests/sim/farm_simulation.h"

#include <deque>
#include <memory>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "server/coordinator/limits.h"
#include "tests/sim/checkers.h"
#include "tests/sim/sim_client.h"
#include "tests/sim/sim_network.h"
#include "tests/sim/sim_random.h"
#include "tests/sim/sim_server.h"
#include "tests/sim/sim_worker.h"
#include "tests/sim/virtual_time.h"

namespace tessera {
namespace {

constexpr int64_t kDownMessagesMax = 16384;  // as towards one worker in production

class Farm {
 public:
  Farm(const FaultPlan& plan, const std::function<void(const std::string&)>& trace)
      : plan_(plan),
        trace_(trace),
        random_(plan.seed ^ 0x5eed),
        checkers_(plan),
        server_(plan, time_, random_, checkers_, TraceOf("server")),
        network_(plan, time_, random_, Ends()) {
    server_.SetNetwork(&network_);
    for (int i = 0; i < std::ssize(plan.workers); ++i) {
      workers_.push_back(std::make_unique<SimWorker>(
          i, plan_, time_, random_, network_,
          [this](int worker, const std::string& name, const v1::FilterLease& lease) {
            return FilterInput(worker, name, lease);
          },
          TraceOf(absl::StrCat("worker ", i))));
    }
    for (int i = 0; i < std::ssize(plan.jobs); ++i) {
      clients_.emplace_back(i, plan_.jobs[static_cast<size_t>(i)], plan_, time_, network_, server_,
                            checkers_);
    }
    server_.SetWatch([this](JobId job) {
      for (SimClient& client : clients_) client.NoteChange(job);
    });
  }

  SimulationResult Run() {
    server_.Start();
    for (size_t i = 0; i < workers_.size(); ++i) {
      time_.After(plan_.workers[i].start_us, [this, i] { workers_[i]->Start(); });
    }
    for (SimClient& client : clients_) client.Start();
    for (const Fault& fault : plan_.faults) {
      time_.After(fault.at_us, [this, fault] { Inject(fault); });
    }
    time_.After(plan_.faults_end_us, [this] { server_.platter().is_full = false; });
    Watch();
    while (checkers_.violation().empty() && !done_ && time_.RunNext(plan_.end_us)) {
    }
    const int64_t jobs_ended_ms = time_.now_us() / kMs;
    if (checkers_.violation().empty()) CheckEnd();
    return {checkers_.violation(), checkers_.steps(),     checkers_.counted(),
            network_.corrupted(),  time_.now_us() / kMs, jobs_ended_ms,
            server_.windows_filtered(), std::ssize(server_.platter().bans),
            BuildsGivenUp()};
  }

 private:
  std::function<void(const std::string&)> TraceOf(const std::string& who) {
    return [this, who](const std::string& line) {
      if (trace_) trace_(absl::StrFormat("%10.3f s  %s %s", 1e-6 * time_.now_us(), who, line));
    };
  }

  absl::StatusOr<std::string> FilterInput(int worker, const std::string& name,
                                          const v1::FilterLease& lease) {
    if (network_.IsCutOff(worker) || network_.LosesCall()) {
      return absl::UnavailableError("the link is down");
    }
    return server_.FilterInput(name, lease.id());
  }

  SimNetwork::Ends Ends() {
    return {.accepts = [this] { return server_.is_up(); },
            .to_server = [this](uint64_t s,
                                v1::WorkerMessage m) { server_.Receive(s, std::move(m)); },
            .server_lost = [this](uint64_t s) { server_.Lost(s); },
            .to_worker =
                [this](int w, uint64_t s, v1::CoordinatorMessage m) {
                  Worker(w).Receive(s, std::move(m));
                },
            .written = [this](int w, uint64_t s) { Worker(w).Written(s); },
            .worker_lost = [this](int w, uint64_t s,
                                  const absl::Status& status) { Worker(w).Lost(s, status); }};
  }
  SimWorker& Worker(int index) { return *workers_.at(static_cast<size_t>(index)); }

  // Now and then: queues are bounded, what was acknowledged holds, and whether all is over.
  void Watch() {
    for (const auto& worker : workers_) {
      if (std::string broken = worker->BoundsBroken(); !broken.empty()) checkers_.Fail(broken);
    }
    if (network_.down_messages_max() > kDownMessagesMax) {
      checkers_.Fail("too many messages on their way to a worker");
    }
    done_ = time_.now_us() >= plan_.faults_end_us;
    for (SimClient& client : clients_) {
      client.CheckAcknowledged();
      done_ = done_ && client.IsDone();
    }
    time_.After(50 * kMs, [this] { Watch(); });
  }

  void Inject(const Fault& fault) {
    const int64_t for_us = fault.for_us;
    switch (fault.kind) {
      case FaultKind::kWorkerKilled:
        return Worker(fault.target).Die(for_us, false);
      case FaultKind::kWorkerVanishes:
        return Worker(fault.target).Die(for_us, true);
      case FaultKind::kWorkerStalls:
        return Worker(fault.target).Stall(for_us);
      case FaultKind::kRenderHangs:
        return Worker(fault.target).HangNextRender(for_us);
      case FaultKind::kBuildHangs:
        return Worker(fault.target).HangNextBuild(for_us);
      case FaultKind::kWorkerCrashes:
        return Worker(fault.target).CrashBySignal();
      case FaultKind::kWorkerDrains:
        return Worker(fault.target).Drain(for_us);
      case FaultKind::kPartition:
        TraceOf("network")(absl::StrCat("cuts off worker ", fault.target, " for ", for_us / kMs,
                                        " ms"));
        return network_.Partition(fault.target, for_us);
      case FaultKind::kServerCrash:
        return server_.Crash(for_us);
      case FaultKind::kDiskFull:
        TraceOf("disk")(absl::StrCat("is full for ", for_us / kMs, " ms"));
        server_.DiskIsFullFor(for_us);
        time_.After(for_us, [this] { server_.platter().is_full = false; });
        return;
      case FaultKind::kFilmDamaged:
        for (auto& [job, film] : server_.platter().films) {
          const auto row = server_.platter().rows.find(job);
          v1::Job record;
          // The film of a job that has ended is all there is of it: that loss is not mended.
          if (row == server_.platter().rows.end() || !record.ParseFromString(row->second.record) ||
              record.state() == v1::JOB_STATE_DONE || record.state() == v1::JOB_STATE_FINISHING ||
              record.state() == v1::JOB_STATE_CANCELLED) {
            continue;
          }
          TraceOf("disk")(absl::StrCat("damages the film of jobs/", job));
          film.damaged = true;
        }
        return;
    }
  }

  int64_t BuildsGivenUp() const {
    int64_t builds = 0;
    for (const auto& worker : workers_) builds += worker->builds_given_up();
    return builds;
  }

  // The jobs that have not ended, and who has leases of them.
  std::string WhatIsLeft() {
    if (!server_.is_up()) return "; the server is down";
    std::string left;
    server_.host().Read([&](const Coordinator& c) {
      for (const v1::Job& job : c.ListJobs(0, SIZE_MAX)) {
        if (job.has_end_time()) continue;
        absl::StrAppend(&left, "; ", job.name(), " ", v1::JobState_Name(job.state()), " ",
                        job.progress().samples(), "/", job.progress().samples_total(), " ",
                        job.waiting());
      }
      for (const v1::Worker& worker : c.ListWorkers({})) {
        absl::StrAppend(&left, "; ", worker.name(), " of ", worker.host(), ", ", worker.threads(),
                        " threads, ", worker.samples(), " samples");
      }
      for (const Coordinator::LeaseView& lease : c.ListLeases()) {
        absl::StrAppend(&left, "; session ", lease.session, " has ", JobName(lease.job), " tile ",
                        lease.unit.tile, " [", lease.unit.range.begin, ", ", lease.unit.range.end,
                        ") ", v1::LeaseProgress::State_Name(lease.state), " ", lease.samples);
      }
      return 0;
    });
    return left;
  }

  // All jobs have ended, with the right bits, and that is what a restart finds.
  void CheckEnd() {
    if (!done_) return checkers_.Fail(
        absl::StrCat("some job has not ended long after the last fault", WhatIsLeft()));
    for (SimClient& client : clients_) client.CheckEnd();
    const int64_t settled_us = time_.now_us() + 10 * kSecond;
    while (checkers_.violation().empty() && time_.RunNext(settled_us)) {
    }
    server_.Crash(kSecond);
    while (checkers_.violation().empty() && !server_.is_up() && time_.RunNext(plan_.end_us * 2)) {
    }
    if (!checkers_.violation().empty()) return;
    for (SimClient& client : clients_) {
      if (!client.IsDone()) checkers_.Fail("a job that had ended goes on after a restart");
      client.CheckEnd();
    }
  }

  const FaultPlan& plan_;
  const std::function<void(const std::string&)>& trace_;
  VirtualTime time_;
  SimRandom random_;
  Checkers checkers_;
  SimServer server_;
  SimNetwork network_;
  std::vector<std::unique_ptr<SimWorker>> workers_;
  std::deque<SimClient> clients_;
  bool done_ = false;
};

}  // namespace

SimulationResult Simulate(const FaultPlan& plan,
                          const std::function<void(const std::string&)>& trace) {
  return Farm(plan, trace).Run();
}

}  // namespace tessera
