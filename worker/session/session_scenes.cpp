// The part of SessionMachine that decides which scenes are built, kept and dropped.
#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "worker/session/job_conversion.h"
#include "worker/session/session_machine.h"

namespace tessera {

using namespace session_effect;

void SessionMachine::SettleLeases() {
  const std::deque<uint64_t> waiting = waiting_;
  for (const uint64_t id : waiting) {
    const auto held = leases_.find(id);
    if (held != leases_.end()) SettleLease(id, held->second);  // else an earlier one failed its job
  }
}

void SessionMachine::SettleLease(uint64_t id, HeldLease& held) {
  if (held.filter) return;
  const std::string job = held.lease.job();
  auto found = scenes_.find(held.scene);
  if (found != scenes_.end() && found->second.state == SceneEntry::State::kCrowded &&
      MakeRoom(found->second.bytes)) {
    scenes_.erase(found);
    found = scenes_.end();
  }
  if (found == scenes_.end()) {
    if (!building_.empty()) return;
    // What the scene will need is not known yet, but that it is hardly less than its files.
    const int64_t bytes_least = AssetBytesOf(jobs_[job].settings);
    if (bytes_least <= options_.memory_bytes) MakeRoom(bytes_least);
    building_ = held.scene;
    build_cancelled_ = build_given_up_ = false;
    build_unwanted_for_ = {};
    build_unwanted_.reset();
    scenes_[held.scene].last_use = ++use_counter_;
    Emit(BuildScene{held.scene, jobs_[job].settings, job});
    return;
  }
  SceneEntry& scene = found->second;
  switch (scene.state) {
    case SceneEntry::State::kBuilding:
      break;
    case SceneEntry::State::kReady:
      renders_may_start_ = true;
      break;
    case SceneEntry::State::kCrowded:
      Decline(id, v1::DeclineLease::REASON_ASSETS,
              "scenes of other jobs fill this worker's memory");
      EraseLease(id);
      break;
    case SceneEntry::State::kFailed:
      scene.last_use = ++use_counter_;
      if (scene.outcome.kind == BuildOutcome::Kind::kScene) {
        FailScene(job, scene.outcome.detail);
      } else {
        Decline(id, v1::DeclineLease::REASON_MEMORY, scene.outcome.detail);
        EraseLease(id);
      }
      break;
  }
}

void SessionMachine::FailScene(const std::string& job, const std::string& error) {
  v1::SceneFailure* failure = control_.emplace_back().mutable_scene_failure();
  failure->set_job(job);
  failure->set_error(error);
  ForgetJob(job);
}

void SessionMachine::On(session_event::SceneBuilt& event) {
  building_.clear();
  const auto found = scenes_.find(event.scene);
  if (found == scenes_.end()) return;
  SceneEntry& scene = found->second;
  scene.outcome = std::move(event.outcome);
  switch (scene.outcome.kind) {
    case BuildOutcome::Kind::kReady: {
      const int64_t bytes = scene.outcome.report.memory_bytes();
      LogLine(absl::StrCat("scene=", event.scene.substr(0, 12),
                           " triangles=", scene.outcome.report.triangles(), " mib=", bytes >> 20,
                           " seconds=", scene.outcome.report.load_seconds(), " built"));
      if (options_.memory_bytes > 0 && bytes > options_.memory_bytes) {
        Emit(DropScene{event.scene});
        scene.state = SceneEntry::State::kFailed;
        scene.outcome.kind = BuildOutcome::Kind::kMemory;
        scene.outcome.detail = absl::StrCat("the scene needs ", bytes, " bytes, this worker has ",
                                            options_.memory_bytes);
      } else if (MakeRoom(bytes)) {
        scene.state = SceneEntry::State::kReady;
        scene.bytes = bytes;
      } else {
        Emit(DropScene{event.scene});
        scene.state = SceneEntry::State::kCrowded;
        scene.bytes = bytes;
      }
      break;
    }
    case BuildOutcome::Kind::kMemory:
    case BuildOutcome::Kind::kScene:
      LogLine(absl::StrCat("scene=", event.scene.substr(0, 12), " failed: ", scene.outcome.detail),
              LogLevel::kWarning);
      scene.state = SceneEntry::State::kFailed;
      break;
    case BuildOutcome::Kind::kAssets: {
      LogLine(scene.outcome.detail, LogLevel::kWarning);
      const std::deque<uint64_t> waiting = waiting_;
      for (const uint64_t id : waiting) {
        if (leases_[id].scene != event.scene) continue;
        Decline(id, v1::DeclineLease::REASON_ASSETS, scene.outcome.detail);
        EraseLease(id);
      }
      scenes_.erase(found);
      break;
    }
    case BuildOutcome::Kind::kCancelled:
      scenes_.erase(found);
      break;
  }
  LimitScenes();
  SettleLeases();
}

std::set<std::string> SessionMachine::ScenesInUse() const {
  std::set<std::string> used;
  for (const auto& [id, held] : leases_) used.insert(held.scene);
  return used;
}

bool SessionMachine::MakeRoom(int64_t bytes_more) {
  if (options_.memory_bytes <= 0) return true;
  const std::set<std::string> used = ScenesInUse();
  while (true) {
    int64_t bytes = bytes_more;
    auto oldest = scenes_.end();
    for (auto scene = scenes_.begin(); scene != scenes_.end(); ++scene) {
      if (scene->second.state != SceneEntry::State::kReady) continue;
      bytes += scene->second.bytes;
      if (used.contains(scene->first)) continue;
      if (oldest == scenes_.end() || scene->second.last_use < oldest->second.last_use) {
        oldest = scene;
      }
    }
    if (bytes <= options_.memory_bytes) return true;
    if (oldest == scenes_.end()) return false;
    ForgetScene(std::string(oldest->first));
  }
}

void SessionMachine::LimitScenes() {
  const std::set<std::string> used = ScenesInUse();
  while (scenes_.size() > kScenesMax) {
    auto oldest = scenes_.end();
    for (auto scene = scenes_.begin(); scene != scenes_.end(); ++scene) {
      if (scene->first == building_ || used.contains(scene->first)) continue;
      if (oldest == scenes_.end() || scene->second.last_use < oldest->second.last_use) {
        oldest = scene;
      }
    }
    if (oldest == scenes_.end()) return;
    ForgetScene(std::string(oldest->first));
  }
}

void SessionMachine::ForgetScene(const std::string& scene) {
  const auto found = scenes_.find(scene);
  if (found->second.state == SceneEntry::State::kReady) Emit(DropScene{scene});
  scenes_.erase(found);
}

}  // namespace tessera
