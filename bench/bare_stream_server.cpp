#include "bench/bare_stream_server.h"

#include <grpcpp/server.h>
#include <grpcpp/server_builder.h>

#include <atomic>
#include <bit>
#include <condition_variable>
#include <deque>
#include <fstream>
#include <mutex>
#include <set>

#include "tessera/v1/worker.grpc.pb.h"

namespace tessera {
namespace {

class Session;

struct Plan {
  int64_t num_leases = 0, num_tiles = 0, num_passes = 1;
  int tile_size = 0, ahead = 0;
  std::atomic<int64_t> num_open = 0;  // leases of the rounds that have begun
  std::atomic<int64_t> handed_out = 0;
  std::atomic<int64_t> received = 0;
  std::mutex mutex;
  std::condition_variable all_received;
  std::set<Session*> sessions;  // guarded by mutex
};

v1::Lease LeaseOf(const Plan& plan, int64_t index) {
  const int64_t pass = index / plan.num_tiles % plan.num_passes;
  v1::Lease lease;
  lease.set_id(static_cast<uint64_t>(index) + 1);
  lease.set_job("jobs/1");
  lease.set_tile_index(index % plan.num_tiles);
  lease.mutable_window()->set_width(plan.tile_size);
  lease.mutable_window()->set_height(plan.tile_size);
  lease.set_sample_begin(pass == 0 ? 0 : int64_t{1} << pass);
  lease.set_sample_end(int64_t{2} << pass);
  return lease;
}

class Session : public grpc::ServerBidiReactor<v1::WorkerMessage, v1::CoordinatorMessage> {
 public:
  explicit Session(Plan* plan) : plan_(plan) {
    const std::lock_guard lock(plan->mutex);
    plan->sessions.insert(this);
    StartRead(&incoming_);
  }

  void Begin() {
    for (int i = 0; i < plan_->ahead; ++i) HandOut();
  }

  void OnReadDone(bool ok) override {
    if (!ok) {
      Finish(grpc::Status::OK);
      return;
    }
    if (incoming_.has_hello()) {
      v1::CoordinatorMessage welcome;
      welcome.mutable_welcome();
      Queue(std::move(welcome));
    } else if (incoming_.has_delta()) {
      if (++plan_->received % plan_->num_leases == 0) {
        const std::lock_guard lock(plan_->mutex);
        plan_->all_received.notify_all();
      }
      HandOut();
    }
    StartRead(&incoming_);
  }
  void OnWriteDone(bool ok) override {
    const std::lock_guard lock(mutex_);
    is_writing_ = false;
    if (ok) WriteNext();
  }
  void OnDone() override {
    {
      const std::lock_guard lock(plan_->mutex);
      plan_->sessions.erase(this);
    }
    delete this;
  }

 private:
  void HandOut() {
    int64_t index = plan_->handed_out;
    do {
      if (index >= plan_->num_open) return;
    } while (!plan_->handed_out.compare_exchange_weak(index, index + 1));
    v1::CoordinatorMessage message;
    *message.mutable_lease() = LeaseOf(*plan_, index);
    Queue(std::move(message));
  }
  void Queue(v1::CoordinatorMessage message) {
    const std::lock_guard lock(mutex_);
    queue_.push_back(std::move(message));
    if (!is_writing_) WriteNext();
  }
  void WriteNext() {
    if (queue_.empty()) return;
    outgoing_ = std::move(queue_.front());
    queue_.pop_front();
    is_writing_ = true;
    StartWrite(&outgoing_);
  }

  Plan* plan_;
  v1::WorkerMessage incoming_;
  std::mutex mutex_;
  v1::CoordinatorMessage outgoing_;  // guarded by mutex_, as all below
  std::deque<v1::CoordinatorMessage> queue_;
  bool is_writing_ = false;
};

class Service : public v1::WorkerService::CallbackService {
 public:
  explicit Service(Plan* plan) : plan_(plan) {}
  grpc::ServerBidiReactor<v1::WorkerMessage, v1::CoordinatorMessage>* Work(
      grpc::CallbackServerContext*) override {
    return new Session(plan_);
  }
  grpc::ServerUnaryReactor* ListWorkers(grpc::CallbackServerContext* context,
                                        const v1::ListWorkersRequest*,
                                        v1::ListWorkersResponse*) override {
    {
      const std::lock_guard lock(plan_->mutex);
      plan_->num_open += plan_->num_leases;
      for (Session* const session : plan_->sessions) session->Begin();
    }
    grpc::ServerUnaryReactor* const reactor = context->DefaultReactor();
    reactor->Finish(grpc::Status::OK);
    return reactor;
  }

 private:
  Plan* plan_;
};

}  // namespace

void RunBareStreamServer(const std::string& port_file, int num_rounds, int64_t num_leases,
                         int64_t num_tiles, int64_t spp, int tile_size, int ahead) {
  Plan plan;
  plan.num_leases = num_leases;
  plan.num_tiles = num_tiles;
  plan.num_passes = std::bit_width(static_cast<uint64_t>(spp)) - 1;
  plan.tile_size = tile_size;
  plan.ahead = ahead;
  Service service(&plan);
  grpc::ServerBuilder builder;
  int port = 0;
  builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port);
  builder.RegisterService(&service);
  const std::unique_ptr<grpc::Server> server = builder.BuildAndStart();
  std::ofstream(port_file) << "GRPC=" << port << "\n";
  std::unique_lock lock(plan.mutex);
  plan.all_received.wait(lock, [&] { return plan.received >= num_rounds * num_leases; });
  lock.unlock();
  server->Shutdown(std::chrono::system_clock::now());
}

}  // namespace tessera
