#include "bench/synthetic_workers.h"

#include <grpcpp/client_context.h>

#include <chrono>
#include <condition_variable>
#include <deque>
#include <mutex>

#include "absl/strings/str_cat.h"
#include "bench/farm_under_test.h"
#include "core/film/delta_codec.h"
#include "server/coordinator/worker_message.h"
#include "worker/integrator/arithmetic.h"

namespace tessera {
namespace {

constexpr std::chrono::milliseconds kHeartbeatInterval{400};

int64_t StockKeyOf(SampleRange range) { return (range.begin << 32) + range.size(); }

}  // namespace

DeltaStock::DeltaStock(const PathTracer& tracer, const PixelRect& window, int64_t spp,
                       int64_t feature_end)
    : feature_end_(feature_end) {
  // Every aligned node up to spp: whatever sizes the coordinator asks for.
  for (int64_t size = 1; size <= spp; size *= 2) {
    for (int64_t begin = 0; begin + size <= spp; begin += size) {
      RenderCounters counters;
      const SampleRange range{begin, begin + size};
      const auto start = std::chrono::steady_clock::now();
      const auto tile = tracer.Render(window, range, nullptr, &counters);
      if (!tile.ok()) Die(tile.status().ToString());
      const auto render_time = std::chrono::steady_clock::now() - start;
      EncodedDelta encoded = EncodeDelta(*tile, DeltaEncoding::kPackedBlocks);
      entries_[StockKeyOf(range)] = {std::move(encoded.payload), encoded.payload_bytes,
                                     counters.rays,
                                     std::chrono::nanoseconds(render_time).count()};
    }
  }
}

v1::TileDelta DeltaStock::Answer(const v1::Lease& lease) const {
  const SampleRange range{lease.sample_begin(), lease.sample_end()};
  const auto found = entries_.find(StockKeyOf(range));
  if (found == entries_.end()) Die("a lease of a range that the stock does not have");
  const Entry& entry = found->second;
  v1::TileDelta delta;
  delta.set_lease_id(lease.id());
  delta.set_job(lease.job());
  delta.set_tile_index(lease.tile_index());
  *delta.mutable_window() = lease.window();
  delta.set_sample_begin(range.begin);
  delta.set_sample_end(range.end);
  delta.set_payload(entry.payload);
  delta.set_encoding(static_cast<uint32_t>(DeltaEncoding::kPackedBlocks));
  delta.set_payload_bytes(entry.payload_bytes);
  delta.set_rays(entry.rays);
  delta.mutable_render_time()->set_seconds(entry.render_ns / 1000000000);
  delta.mutable_render_time()->set_nanos(static_cast<int>(entry.render_ns % 1000000000));
  delta.set_feature_end(feature_end_);
  delta.set_checksum(DeltaChecksum(KeyOf(delta), delta.payload()));
  return delta;
}

// Threads: gRPC's, one reaction at a time for reads and one for writes.
class SyntheticWorker::Reactor
    : public grpc::ClientBidiReactor<v1::WorkerMessage, v1::CoordinatorMessage> {
 public:
  Reactor(v1::WorkerService::Stub* stub, v1::WorkerMessage hello, const DeltaStock& stock,
          LoadCounters* counters)
      : stock_(stock), counters_(counters), outgoing_(std::move(hello)), is_writing_(true) {
    stub->async()->Work(&context_, this);
    StartWrite(&outgoing_);
    StartRead(&incoming_);
    StartCall();
  }

  void OnReadDone(bool ok) override {
    if (!ok) return;
    if (incoming_.has_welcome()) {
      ++counters_->welcomes;
    } else if (incoming_.has_job()) {
      v1::WorkerMessage ready;
      ready.mutable_scene_ready()->set_job(incoming_.job().job());
      Queue(std::move(ready));
    } else if (incoming_.has_lease()) {
      ++counters_->leases;
      v1::WorkerMessage message;
      *message.mutable_delta() = stock_.Answer(incoming_.lease());
      Queue(std::move(message));
    }
    StartRead(&incoming_);
  }
  void OnWriteDone(bool ok) override {
    const std::lock_guard lock(mutex_);
    if (outgoing_.has_delta() && ok) {
      ++counters_->deltas;
      counters_->bytes += static_cast<int64_t>(outgoing_.ByteSizeLong());
    }
    is_writing_ = false;
    if (ok) WriteNext();
  }
  void OnDone(const grpc::Status&) override {
    const std::lock_guard lock(mutex_);
    is_done_ = true;
    done_.notify_all();
  }
  void Beat() {
    const std::lock_guard lock(mutex_);
    queue_.push_back(HeartbeatLocked());
    if (!is_writing_) WriteNext();
  }
  void CancelAndWait() {
    context_.TryCancel();
    std::unique_lock lock(mutex_);
    done_.wait(lock, [this] { return is_done_; });
  }

 private:
  void Queue(v1::WorkerMessage message) {
    const std::lock_guard lock(mutex_);
    queue_.push_back(std::move(message));
    if (!is_writing_) WriteNext();
  }
  void WriteNext() {
    if (queue_.empty()) return;
    const auto now = std::chrono::steady_clock::now();
    if (now - last_heartbeat_ > kHeartbeatInterval) {
      last_heartbeat_ = now;
      outgoing_ = HeartbeatLocked();
    } else {
      outgoing_ = std::move(queue_.front());
      queue_.pop_front();
    }
    is_writing_ = true;
    StartWrite(&outgoing_);
  }

  // Renews the leases whose deltas wait for the link.
  v1::WorkerMessage HeartbeatLocked() const {
    v1::WorkerMessage message;
    v1::Heartbeat& heartbeat = *message.mutable_heartbeat();
    for (const v1::WorkerMessage& waiting : queue_) {
      if (!waiting.has_delta()) continue;
      v1::LeaseProgress& progress = *heartbeat.add_leases();
      progress.set_id(waiting.delta().lease_id());
      progress.set_state(v1::LeaseProgress::STATE_SENDING);
    }
    return message;
  }

  const DeltaStock& stock_;
  LoadCounters* counters_;
  grpc::ClientContext context_;
  v1::CoordinatorMessage incoming_;
  std::mutex mutex_;
  std::condition_variable done_;
  v1::WorkerMessage outgoing_;           // guarded by mutex_, as all below
  std::deque<v1::WorkerMessage> queue_;  // at most as many as the coordinator leases at once
  std::chrono::steady_clock::time_point last_heartbeat_ = std::chrono::steady_clock::now();
  bool is_writing_ = false;
  bool is_done_ = false;
};

SyntheticWorker::SyntheticWorker(const std::shared_ptr<grpc::Channel>& channel, int index,
                                 const std::string& version, const DeltaStock& stock,
                                 LoadCounters* counters)
    : stub_(v1::WorkerService::NewStub(channel)) {
  v1::WorkerMessage message;
  v1::Hello& hello = *message.mutable_hello();
  hello.set_host(absl::StrCat("synthetic", index));
  hello.set_process_id(index + 1);
  hello.set_threads(1);
  hello.set_memory_bytes(int64_t{1} << 34);
  hello.set_version(version);
  for (const std::string& isa : SupportedIsaClasses()) {
    hello.add_isa_classes(isa);
    hello.add_arithmetic(ArithmeticOf(isa));
  }
  reactor_ = std::make_unique<Reactor>(stub_.get(), std::move(message), stock, counters);
}

void SyntheticWorker::Beat() { reactor_->Beat(); }

SyntheticWorker::~SyntheticWorker() { reactor_->CancelAndWait(); }

}  // namespace tessera
