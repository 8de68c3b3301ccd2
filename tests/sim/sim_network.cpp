#include "tests/sim/sim_network.h"

#include <algorithm>
#include <utility>

namespace tessera {
namespace {

// As MakeWorkerChannel and the service set them.
constexpr int64_t kWorkerKeepaliveUs = 15 * kSecond;
constexpr int64_t kServerKeepaliveUs = 30 * kSecond;
constexpr int64_t kConnectTimeoutUs = 5 * kSecond;

}  // namespace

int64_t SimNetwork::Delay() {
  int64_t delay = random_.Between(plan_.network.delay_us_min, plan_.network.delay_us_max);
  if (!Calm() && random_.Chance(plan_.network.slow)) delay += random_.Between(0, 2 * kSecond);
  return delay;
}

bool SimNetwork::IsCut(int worker) const {
  const auto cut = cut_until_us_.find(worker);
  return cut != cut_until_us_.end() && time_.now_us() < cut->second;
}

SimNetwork::State* SimNetwork::Find(Stream stream) {
  const auto found = streams_.find(stream);
  return found == streams_.end() ? nullptr : &found->second;
}

void SimNetwork::Forget(Stream stream) {
  const State* const state = Find(stream);
  if (state != nullptr && !state->worker_open && !state->server_open) streams_.erase(stream);
}

SimNetwork::Stream SimNetwork::Open(int worker) {
  const Stream stream = next_++;
  streams_[stream].worker = worker;
  if (IsCut(worker) || !ends_.accepts()) {
    EndWorkerSide(stream, IsCut(worker) ? kConnectTimeoutUs : Delay(),
                  absl::UnavailableError("nobody answers"));
  } else {
    streams_[stream].server_open = true;
  }
  return stream;
}

void SimNetwork::WriteUp(Stream stream, v1::WorkerMessage message) {
  const State* const state = Find(stream);
  if (state == nullptr || !state->worker_open) return;
  const int worker = state->worker;
  time_.After(random_.Between(10, 200), [this, stream, worker] { ends_.written(worker, stream); });
  Carry(stream, std::move(message), true);
}

void SimNetwork::WriteDown(Stream stream, v1::CoordinatorMessage message) {
  const State* const state = Find(stream);
  if (state == nullptr || !state->server_open || state->closing) return;
  Carry(stream, std::move(message), false);
}

// Hello and Welcome are part of the connection's making: they come once, before all others.
void SimNetwork::Carry(Stream stream, Message message, bool up) {
  State& state = *Find(stream);
  const auto* const from_worker = std::get_if<v1::WorkerMessage>(&message);
  const bool is_greeting =
      from_worker != nullptr ? from_worker->has_hello()
                             : std::get<v1::CoordinatorMessage>(message).has_welcome();
  int copies = 1;
  if (!Calm() && !is_greeting) {
    if (random_.Chance(plan_.network.loss)) {
      if (plan_.network.keeps_order) {
        Break(stream, absl::UnavailableError("the connection was reset"));
        return;
      }
      copies = 0;
    } else if (!plan_.network.keeps_order && random_.Chance(plan_.network.repeat)) {
      copies = 2;
    }
  }
  for (; copies > 0; --copies) {
    Message copy = message;
    if (from_worker != nullptr && !Calm() &&
        (from_worker->has_delta() || from_worker->has_filtered()) &&
        random_.Chance(plan_.network.corrupt)) {
      copy = Corrupt(*from_worker);
    }
    int64_t arrival_us = time_.now_us() + Delay();
    if (plan_.network.keeps_order) {
      int64_t& until_us = up ? state.up_until_us : state.down_until_us;
      arrival_us = until_us = std::max(until_us, arrival_us);
    }
    if (!up) {
      if (state.welcome_us < 0) state.welcome_us = arrival_us;
      arrival_us = std::max(arrival_us, state.welcome_us);
    }
    if (!up) down_messages_max_ = std::max(down_messages_max_, ++state.down_messages);
    time_.After(arrival_us - time_.now_us(), [this, stream, up, copy = std::move(copy)] {
      Arrive(stream, copy, up);
    });
  }
}

void SimNetwork::Arrive(Stream stream, const Message& message, bool up) {
  State* const state = Find(stream);
  if (state == nullptr) return;
  if (IsCut(state->worker)) {
    if (!plan_.network.keeps_order) return;
    // Sent again and again until the link is back; in order, as what follows waits as well.
    const int64_t back_us = cut_until_us_.at(state->worker);
    time_.After(back_us - time_.now_us(),
                [this, stream, up, message] { Arrive(stream, message, up); });
    return;
  }
  if (up) {
    if (state->server_open && !state->closing) {
      ends_.to_server(stream, std::get<v1::WorkerMessage>(message));
    }
    return;
  }
  --state->down_messages;
  if (state->worker_open && !state->vanished) {
    ends_.to_worker(state->worker, stream, std::get<v1::CoordinatorMessage>(message));
  }
}

v1::WorkerMessage SimNetwork::Corrupt(const v1::WorkerMessage& message) {
  ++corrupted_;
  std::string bytes = message.SerializeAsString();
  for (int64_t flips = random_.Between(1, 3); flips > 0; --flips) {
    const auto at = static_cast<size_t>(random_.Between(0, std::ssize(bytes) - 1));
    bytes[at] = static_cast<char>(bytes[at] ^ (1 << random_.Between(0, 7)));
  }
  v1::WorkerMessage corrupt;
  if (!corrupt.ParseFromString(bytes)) corrupt.Clear();  // refused as one without a message
  return corrupt;
}

void SimNetwork::EndWorkerSide(Stream stream, int64_t delay_us, const absl::Status& status) {
  time_.After(delay_us, [this, stream, status] {
    State* const state = Find(stream);
    if (state == nullptr || !state->worker_open) return;
    state->worker_open = false;
    const int worker = state->worker;
    const bool vanished = state->vanished;
    Forget(stream);
    if (!vanished) ends_.worker_lost(worker, stream, status);
  });
}

void SimNetwork::EndServerSide(Stream stream, int64_t delay_us) {
  time_.After(delay_us, [this, stream] {
    State* const state = Find(stream);
    if (state == nullptr || !state->server_open) return;
    state->server_open = false;
    Forget(stream);
    ends_.server_lost(stream);
  });
}

void SimNetwork::Break(Stream stream, const absl::Status& status) {
  State* const state = Find(stream);
  if (state == nullptr) return;
  const bool cut = IsCut(state->worker);
  EndWorkerSide(stream, cut ? kWorkerKeepaliveUs : Delay(), status);
  EndServerSide(stream, cut ? kServerKeepaliveUs : Delay());
}

void SimNetwork::HalfClose(Stream stream) {
  State* const state = Find(stream);
  if (state == nullptr) return;
  const int64_t after_us = std::max(state->up_until_us - time_.now_us(), int64_t{0}) + Delay();
  EndServerSide(stream, after_us);
  EndWorkerSide(stream, after_us + Delay(), absl::OkStatus());
}

void SimNetwork::Abort(Stream stream) { Break(stream, absl::CancelledError("aborted")); }

void SimNetwork::Close(Stream stream, const absl::Status& status) {
  State* const state = Find(stream);
  if (state == nullptr || state->closing) return;
  state->closing = true;
  const int64_t after_us = std::max(state->down_until_us - time_.now_us(), int64_t{0}) + Delay();
  EndWorkerSide(stream, IsCut(state->worker) ? kWorkerKeepaliveUs : after_us, status);
  EndServerSide(stream, Delay());
}

void SimNetwork::WorkerDied(int worker, bool vanishes) {
  for (auto& [stream, state] : streams_) {
    if (state.worker != worker || state.vanished) continue;
    state.vanished = true;
    EndWorkerSide(stream, 0, absl::OkStatus());
    EndServerSide(stream, vanishes || IsCut(worker) ? kServerKeepaliveUs : Delay());
  }
}

void SimNetwork::ServerDied() {
  for (auto& [stream, state] : streams_) {
    state.server_open = false;
    EndWorkerSide(stream, IsCut(state.worker) ? kWorkerKeepaliveUs : Delay(),
                  absl::UnavailableError("the connection was reset"));
  }
}

void SimNetwork::Partition(int worker, int64_t for_us) {
  cut_until_us_[worker] = std::max(cut_until_us_[worker], time_.now_us() + for_us);
  for (auto& [stream, state] : streams_) {
    if (state.worker != worker) continue;
    if (for_us >= kWorkerKeepaliveUs) {
      EndWorkerSide(stream, kWorkerKeepaliveUs, absl::UnavailableError("keepalive"));
    }
    if (for_us >= kServerKeepaliveUs) EndServerSide(stream, kServerKeepaliveUs);
  }
}

}  // namespace tessera
