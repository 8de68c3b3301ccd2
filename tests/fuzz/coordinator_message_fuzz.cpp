// What a server tells a worker. Input: the letter m and messages, each behind its length in two
// bytes, of one session; or the letter f, a filter lease behind its length, and its planes.
// Whatever a server says, the session keeps its bounds and answers what it has understood; what is
// filtered has the lease's window. Checksums of planes are put right, as a liar would.
#include <google/protobuf/stubs/logging.h>

#include <cstdlib>

#include "core/denoise/denoise_frame.h"
#include "core/denoise/window_codec.h"
#include "tests/core/denoise/synthetic_frame.h"
#include "tests/fuzz/fuzz_target.h"
#include "tests/worker/session/session_driver.h"
#include "worker/session/window_filter.h"

namespace tessera {
namespace {

constexpr int kMessagesMax = 64;
constexpr int kThreads = 2;

void Append(const google::protobuf::Message& message, std::string* out) {
  const std::string bytes = message.SerializeAsString();
  out->push_back(static_cast<char>(bytes.size() & 255));
  out->push_back(static_cast<char>(bytes.size() >> 8));
  out->append(bytes);
}

// False where none is left, or it cannot be parsed.
bool Next(std::string_view* input, google::protobuf::Message* message) {
  if (input->size() < 2) return false;
  const auto* const bytes = reinterpret_cast<const uint8_t*>(input->data());
  const size_t length = std::min<size_t>(bytes[0] + 256u * bytes[1], input->size() - 2);
  const bool is_message = message->ParseFromArray(bytes + 2, static_cast<int>(length));
  input->remove_prefix(2 + length);
  return is_message;
}

// Answers what the machine has asked for since the last call.
class Worker {
 public:
  explicit Worker(Driver& driver) : driver_(driver) {}
  void Answer() {
    for (; builds_ < driver_.builds.size(); ++builds_) {
      driver_.Built(driver_.builds[builds_].scene);
    }
    for (; renders_ < driver_.renders.size(); ++renders_) {
      driver_.Rendered(driver_.renders[renders_].task);
    }
    for (; filters_ < driver_.filters.size(); ++filters_) {
      driver_.Step(session_event::Filtered{driver_.filters[filters_].task,
                                           absl::UnavailableError("no planes")});
    }
  }

 private:
  Driver& driver_;
  size_t builds_ = 0, renders_ = 0, filters_ = 0;
};

// Returns whether the session goes on after all messages.
bool Converse(std::string_view input) {
  Driver driver(kThreads);
  Worker worker(driver);
  driver.Step(session_event::Start{});
  v1::CoordinatorMessage message;
  int received = 0;
  while (received < kMessagesMax && Next(&input, &message)) {
    driver.Receive(message);
    if (++received % 3 == 0) driver.Advance(seconds(2));
    worker.Answer();
    driver.Flush();
    const SessionMachine::Load load = driver.machine().load();
    if (load.leases > SessionMachine::kLeasesMax || load.tasks > 2 * kThreads ||
        load.control > SessionMachine::kControlMessagesMax) {
      std::abort();
    }
    if (driver.aborted > 0) return false;
  }
  return received > 0 && input.empty() && driver.finished.empty();
}

bool Filter(std::string_view input) {
  v1::FilterLease lease;
  if (!Next(&input, &lease)) return false;
  lease.set_input_bytes(std::ssize(input));
  lease.set_input_checksum(PayloadChecksum(std::string(input)));
  if (!FaultOfFilterLease(lease).empty()) return false;
  const std::atomic<bool> cancelled = false;
  std::atomic<int64_t> parts_done = 0;
  const absl::StatusOr<v1::FilteredWindow> filtered =
      FilterWindow(lease, input, cancelled, &parts_done);
  if (!filtered.ok()) {
    if (filtered.status().message().empty()) std::abort();
    return false;
  }
  const v1::Region& w = lease.window();
  if (!DecodeFiltered(PixelRect::FromSize(w.x(), w.y(), w.width(), w.height()),
                      filtered->payload())
           .ok()) {
    std::abort();
  }
  return true;
}

void Set(const PixelRect& rect, v1::Region* region) {
  region->set_x(rect.x_begin);
  region->set_y(rect.y_begin);
  region->set_width(rect.width());
  region->set_height(rect.height());
}

std::string FilterSeed(const std::string& denoiser) {
  const PixelRect frame{5, 7, 29, 31}, window{13, 15, 29, 23};
  const PixelRect bounds =
      window.Expand((*MakeDenoiser(denoiser))->halo_px(DenoiseQuality::kFinal)).Intersect(frame);
  v1::FilterLease lease;
  lease.set_id(7);
  lease.set_job("jobs/1");
  lease.set_denoiser(denoiser);
  lease.set_quality(v1::QUALITY_FINAL);
  lease.set_revision(3);
  Set(frame, lease.mutable_frame());
  Set(window, lease.mutable_window());
  Set(bounds, lease.mutable_bounds());
  std::string seed = "f";
  Append(lease, &seed);
  return seed + EncodeFilterInput(MakeSyntheticFrame(frame, 0.3f, 4, 1).planes, bounds);
}

// Everything that a server says in a short session.
std::string SessionSeed() {
  std::string seed = "m";
  v1::CoordinatorMessage message;
  message.mutable_welcome()->set_worker("workers/1");
  message.mutable_welcome()->mutable_lease_ttl()->set_seconds(2);
  message.mutable_welcome()->mutable_heartbeat_interval()->set_nanos(500000000);
  Append(message, &seed);
  message.mutable_job()->set_job("jobs/1");
  *message.mutable_job()->mutable_settings() = Settings();
  Append(message, &seed);
  for (uint64_t id = 1; id < 8; ++id) {
    v1::Lease& lease = *message.mutable_lease();
    lease.set_id(id);
    lease.set_job("jobs/1");
    Set({0, 0, 16, 16}, lease.mutable_window());
    lease.set_sample_end(16);
    Append(message, &seed);
  }
  v1::FilterLease& filter = *message.mutable_filter();
  filter.set_id(9);
  filter.set_job("jobs/1");
  filter.set_denoiser("bilateral");
  filter.set_quality(v1::QUALITY_FINAL);
  for (v1::Region* region :
       {filter.mutable_frame(), filter.mutable_window(), filter.mutable_bounds()}) {
    Set({0, 0, 16, 16}, region);
  }
  Append(message, &seed);
  message.mutable_revoke()->set_id(7);
  Append(message, &seed);
  message.mutable_forget()->set_job("jobs/1");
  Append(message, &seed);
  return seed;
}

}  // namespace

bool IsTaken(std::string_view input) {
  if (input.empty()) return false;
  return input[0] == 'f' ? Filter(input.substr(1)) : Converse(input.substr(1));
}

void FuzzOne(std::string_view input) { (void)IsTaken(input); }

std::vector<std::string> FuzzSeeds() {
  google::protobuf::SetLogHandler(nullptr);  // what is no UTF-8 is no news here
  return {SessionSeed(), FilterSeed("bilateral"), FilterSeed("regression")};
}

}  // namespace tessera
