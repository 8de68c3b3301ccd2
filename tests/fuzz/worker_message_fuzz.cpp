// What a worker's session says to the coordinator. Input: messages, each behind its length in two
// bytes; checksums of deltas are put right, as a liar would. Whatever it says, an honest worker
// that comes later brings the job to its end, or the job says what it waits for (a scene that the
// liar declined needs a machine with more memory than it claimed).
#include <google/protobuf/stubs/logging.h>

#include <cstdlib>

#include "core/denoise/window_codec.h"
#include "core/film/delta_codec.h"
#include "server/coordinator/job_settings.h"
#include "server/coordinator/worker_message.h"
#include "tests/fuzz/fuzz_target.h"
#include "tests/server/simulated_farm.h"

namespace tessera {
namespace {

constexpr int kMessagesMax = 64;

// nullopt where no message is left.
std::optional<v1::WorkerMessage> NextMessage(std::string_view* input) {
  if (input->size() < 2) return std::nullopt;
  const auto* bytes = reinterpret_cast<const uint8_t*>(input->data());
  const size_t length = std::min<size_t>(bytes[0] + 256u * bytes[1], input->size() - 2);
  v1::WorkerMessage message;
  const bool is_message = message.ParseFromArray(bytes + 2, static_cast<int>(length));
  input->remove_prefix(2 + length);
  if (!is_message) return std::nullopt;
  return message;
}

void Append(const v1::WorkerMessage& message, std::string* out) {
  const std::string bytes = message.SerializeAsString();
  out->push_back(static_cast<char>(bytes.size() & 255));
  out->push_back(static_cast<char>(bytes.size() >> 8));
  out->append(bytes);
}

v1::JobSettings Settings() {
  v1::JobSettings settings = SmallSettings(4);
  settings.set_tile_size(16);
  return settings;
}

// A window that the session's worker, once it has said hello, gets to filter.
void OfferWindow(SimulatedFarm& farm) {
  FilterOfferEvent offer{.ticket = 1};
  offer.lease.set_job("jobs/1");
  *offer.lease.mutable_window() = RegionProto({0, 0, 8, 8});
  farm.Post(std::move(offer));
}

v1::Hello FilterHello(SimulatedFarm& farm) {
  v1::Hello hello = farm.MakeHello("host", 2);
  hello.set_filters(true);
  return hello;
}

uint64_t ChecksumOf(const v1::FilteredWindow& filtered) {
  return FilteredChecksum({filtered.lease_id(), filtered.job(), filtered.revision(),
                           RectOf(filtered.window())},
                          filtered.payload());
}

// The session's messages up to the first that is refused. Returns whether all were taken.
bool Converse(SimulatedFarm& farm, SessionId session, std::string_view input) {
  for (int i = 0; i < kMessagesMax; ++i) {
    std::optional<v1::WorkerMessage> message = NextMessage(&input);
    if (!message) return i > 0 && input.empty();
    // The service opens a session with Hello and takes no other.
    if ((i == 0) != message->has_hello()) return false;
    if (message->has_delta()) {
      v1::TileDelta& delta = *message->mutable_delta();
      delta.set_checksum(DeltaChecksum(KeyOf(delta), delta.payload()));
    }
    if (message->has_filtered()) {
      message->mutable_filtered()->set_checksum(ChecksumOf(message->filtered()));
    }
    absl::StatusOr<Event> event = EventOf(session, message->SerializeAsString(), true);
    if (!event.ok() || !farm.Post(*std::move(event)).status.ok()) return false;
    if (farm.workers[session].closed) return false;
    if (i == 0) OfferWindow(farm);
  }
  return true;
}

// Everything that a small job's only worker says.
std::string Conversation(uint32_t encoding) {
  SimulatedFarm farm;
  farm.Create(Settings());
  v1::WorkerMessage message;
  *message.mutable_hello() = FilterHello(farm);
  std::string out;
  Append(message, &out);
  const SessionId session = farm.next_session++;
  farm.Post(WorkerConnectedEvent{session, FilterHello(farm)});
  OfferWindow(farm);
  SimulatedFarm::SimulatedWorker& worker = farm.workers[session];
  if (!worker.filters.empty()) {
    v1::FilteredWindow& filtered = *message.mutable_filtered();
    filtered.set_lease_id(worker.filters.front().id());
    filtered.set_job("jobs/1");
    *filtered.mutable_window() = worker.filters.front().window();
    filtered.set_payload(EncodeFiltered(FilteredPlanes({0, 0, 8, 8})));
    Append(message, &out);
  }
  message.mutable_scene_ready()->set_job("jobs/1");
  Append(message, &out);
  while (!worker.leases.empty()) {
    const v1::Lease lease = worker.leases.front();
    worker.leases.pop_front();
    message.mutable_heartbeat()->add_leases()->set_id(lease.id());
    Append(message, &out);
    DeltaEvent event = farm.Render(session, lease);
    v1::TileDelta& delta = *message.mutable_delta();
    delta = event.delta;
    *delta.mutable_window() = lease.window();
    delta.set_sample_begin(lease.sample_begin());
    delta.set_sample_end(lease.sample_end());
    delta.set_feature_end(event.tile.feature_end());
    delta.set_encoding(encoding);
    delta.set_payload(EncodeDelta(event.tile, static_cast<DeltaEncoding>(encoding)).payload);
    Append(message, &out);
    farm.Post(std::move(event));
  }
  return out;
}

}  // namespace

bool IsTaken(std::string_view input) {
  SimulatedFarm farm;
  farm.Create(Settings());
  return Converse(farm, farm.next_session++, input);
}

void FuzzOne(std::string_view input) {
  SimulatedFarm farm;
  const JobId job = farm.Create(Settings());
  const SessionId session = farm.next_session++;
  Converse(farm, session, input);
  farm.Disconnect(session);
  farm.now_ms += 1000000;
  farm.Post(TickEvent{});
  farm.Connect(2, "honest");
  farm.RunAll();
  const v1::Job end = farm.Job(job);
  const bool has_ended = end.state() == v1::JOB_STATE_DONE || end.state() == v1::JOB_STATE_FAILED;
  if (!has_ended && end.waiting().empty()) std::abort();
}

std::vector<std::string> FuzzSeeds() {
  google::protobuf::SetLogHandler(nullptr);  // what is no UTF-8 is no news here
  std::vector<std::string> seeds = {Conversation(1), Conversation(2), Conversation(3)};
  SimulatedFarm farm;
  for (int kind = 0; kind < 4; ++kind) {
    std::string out;
    v1::WorkerMessage message;
    *message.mutable_hello() = farm.MakeHello("host", 1);
    if (kind == 3) {
      v1::CrashReport& crash = *message.mutable_hello()->add_crashes();
      crash.set_cause(v1::CrashReport::CAUSE_SIGNAL);
      crash.set_signal(11);
      crash.set_process_id(1);
      v1::CrashReport::Unit& unit = *crash.add_units();
      unit.set_job("jobs/1");
      unit.set_sample_end(2);
    }
    Append(message, &out);
    if (kind == 0) {
      message.mutable_decline()->set_lease_id(1);
      message.mutable_decline()->set_reason(v1::DeclineLease::REASON_MEMORY);
    } else if (kind == 1) {
      message.mutable_scene_failure()->set_job("jobs/1");
      message.mutable_scene_failure()->set_error("no meshes");
    } else if (kind == 2) {
      message.mutable_drain();
    } else {
      message.mutable_heartbeat();
    }
    Append(message, &out);
    seeds.push_back(out);
  }
  return seeds;
}

}  // namespace tessera
