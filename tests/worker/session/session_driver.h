// Drives a SessionMachine without network, threads or renderer.
#pragma once

#include <gtest/gtest.h>

#include <chrono>
#include <initializer_list>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "worker/session/session_machine.h"

namespace tessera {

inline v1::JobSettings Settings(const std::string& scene = "box.glb") {
  v1::JobSettings settings;
  settings.set_scene_name(scene);
  settings.set_width(64);
  settings.set_height(64);
  settings.set_spp(16);
  settings.set_max_depth(4);
  return settings;
}

using namespace session_effect;
using std::chrono::milliseconds;
using std::chrono::seconds;

// Drives one machine: answers its writes when asked to, and sorts its effects.
class Driver {
 public:
  explicit Driver(int threads = 1, int64_t memory_bytes = 0, int attempts_max = 0)
      : machine_(Options(threads, memory_bytes, attempts_max)) {}

  void Step(SessionEvent event) {
    for (SessionEffect& effect : machine_.Step(std::move(event), now_)) Sort(effect);
  }
  // Acknowledges writes until the machine has nothing more to say.
  void Flush() {
    while (write_pending_) {
      write_pending_ = false;
      Step(session_event::WriteDone{true});
    }
  }
  void Advance(milliseconds time) {
    now_ += time;
    Step(session_event::Timer{});
  }
  void Receive(v1::CoordinatorMessage message) {
    Step(session_event::Received{std::move(message)});
  }
  void Welcome() {
    v1::CoordinatorMessage message;
    message.mutable_welcome()->set_worker("workers/1");
    message.mutable_welcome()->mutable_lease_ttl()->set_seconds(9);
    message.mutable_welcome()->mutable_heartbeat_interval()->set_seconds(3);
    Receive(message);
  }
  void Serve() {
    Step(session_event::Start{});
    Flush();
    Welcome();
    Flush();
    sent.clear();
  }
  void Job(const std::string& name, const v1::JobSettings& settings) {
    v1::CoordinatorMessage message;
    message.mutable_job()->set_job(name);
    *message.mutable_job()->mutable_settings() = settings;
    Receive(message);
  }
  void Lease(uint64_t id, const std::string& job = "jobs/1", int64_t begin = 0, int64_t end = 16) {
    v1::CoordinatorMessage message;
    v1::Lease* lease = message.mutable_lease();
    lease->set_id(id);
    lease->set_job(job);
    lease->mutable_window()->set_width(16);
    lease->mutable_window()->set_height(16);
    lease->set_sample_begin(begin);
    lease->set_sample_end(end);
    Receive(message);
  }
  void Built(const std::string& scene, int64_t bytes = 100) {
    session_event::SceneBuilt event;
    event.scene = scene;
    event.outcome.report.set_memory_bytes(bytes);
    Step(event);
  }
  void BuildFails(const std::string& scene, BuildOutcome::Kind kind) {
    session_event::SceneBuilt event;
    event.scene = scene;
    event.outcome.kind = kind;
    event.outcome.detail = "because";
    Step(event);
  }
  // Up to a built scene of jobs/1 that has these leases.
  void ServeScene(std::initializer_list<uint64_t> leases) {
    Serve();
    Job("jobs/1", Settings());
    for (const uint64_t id : leases) Lease(id);
    Built(builds.at(0).scene);
  }
  void Rendered(uint64_t task) {
    v1::TileDelta delta;
    delta.set_payload("x");
    Step(session_event::Rendered{task, delta});
  }

  std::vector<uint64_t> SentDeltas() const {
    std::vector<uint64_t> ids;
    for (const auto& m : sent) {
      if (m.has_delta()) ids.push_back(m.delta().lease_id());
    }
    return ids;
  }
  std::vector<v1::DeclineLease> Declines() const {
    std::vector<v1::DeclineLease> declines;
    for (const auto& m : sent) {
      if (m.has_decline()) declines.push_back(m.decline());
    }
    return declines;
  }

  std::vector<v1::WorkerMessage> sent;
  std::vector<StartRender> renders;
  std::vector<StartFilter> filters;
  std::vector<uint64_t> cancelled;
  std::vector<BuildScene> builds;
  std::vector<std::string> dropped;
  std::vector<absl::Status> finished;
  int opened = 0;
  int aborted = 0;
  int half_closed = 0;
  int build_cancels = 0;
  int given_up = 0;
  int64_t samples_done = 0;  // of each task, as the machine is told

  const SessionMachine& machine() const { return machine_; }
  SessionTime now() const { return now_; }

 private:
  SessionOptions Options(int threads, int64_t memory_bytes, int attempts_max) {
    SessionOptions options;
    options.threads = threads;
    options.memory_bytes = memory_bytes;
    options.connect_attempts_max = attempts_max;
    options.jitter_seed = 7;
    options.samples_of = [this](uint64_t) { return samples_done; };
    return options;
  }
  void Sort(SessionEffect& effect) {
    if (auto* write = std::get_if<Write>(&effect)) {
      ASSERT_FALSE(write_pending_) << "two writes outstanding";
      write_pending_ = true;
      sent.push_back(std::move(write->message));
    }
    if (auto* render = std::get_if<StartRender>(&effect)) renders.push_back(*render);
    if (auto* filter = std::get_if<StartFilter>(&effect)) filters.push_back(*filter);
    if (auto* cancel = std::get_if<CancelRender>(&effect)) cancelled.push_back(cancel->task);
    if (auto* build = std::get_if<BuildScene>(&effect)) builds.push_back(*build);
    if (auto* drop = std::get_if<DropScene>(&effect)) dropped.push_back(drop->scene);
    if (auto* finish = std::get_if<Finish>(&effect)) finished.push_back(finish->status);
    if (std::holds_alternative<OpenStream>(effect)) {
      write_pending_ = false;
      ++opened;
    }
    if (std::holds_alternative<AbortStream>(effect)) ++aborted;
    if (std::holds_alternative<HalfClose>(effect)) ++half_closed;
    if (std::holds_alternative<CancelBuild>(effect)) ++build_cancels;
    if (std::holds_alternative<GiveUp>(effect)) ++given_up;
  }

  SessionMachine machine_;
  SessionTime now_{seconds(1000)};
  bool write_pending_ = false;
};

}  // namespace tessera
