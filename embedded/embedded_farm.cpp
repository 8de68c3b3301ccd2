#include "embedded/embedded_farm.h"

#include <atomic>
#include <thread>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/synchronization/mutex.h"
#include "server/service.h"
#include "worker/session/worker_session.h"

namespace tessera {
namespace {

class EmbeddedFarm : public LocalFarm {
 public:
  EmbeddedFarm(std::unique_ptr<Service> service, const LocalFarmOptions& options)
      : service_(std::move(service)),
        channel_(service_->InProcessChannel()),
        session_(channel_, SessionOptions(options)),
        worker_([this, on_end = options.on_worker_end] { Work(on_end); }) {}

  ~EmbeddedFarm() override {
    stopping_ = true;
    session_.Stop();
    worker_.join();
    channel_.reset();
    service_->Shutdown();
  }

  std::shared_ptr<grpc::Channel> channel() override { return channel_; }

  absl::Status worker_status() const override {
    absl::MutexLock lock(&mu_);
    return worker_status_;
  }

 private:
  static WorkerOptions SessionOptions(const LocalFarmOptions& options) {
    WorkerOptions worker;
    worker.threads = options.threads;
    worker.same_process = true;
    return worker;
  }

  void Work(const std::function<void()>& on_end) {
    const absl::Status status = session_.Run();
    if (stopping_) return;
    {
      absl::MutexLock lock(&mu_);
      worker_status_ =
          status.ok() ? absl::InternalError("the worker inside this process ended by itself")
                      : status;
    }
    if (on_end) on_end();
  }

  std::unique_ptr<Service> service_;
  std::shared_ptr<grpc::Channel> channel_;
  WorkerSession session_;
  std::atomic<bool> stopping_ = false;
  mutable absl::Mutex mu_;
  absl::Status worker_status_ ABSL_GUARDED_BY(mu_);
  std::thread worker_;  // runs session_; last, so that all that it uses exists
};

}  // namespace

absl::StatusOr<std::unique_ptr<LocalFarm>> StartEmbeddedFarm(const LocalFarmOptions& options) {
  ServiceOptions service_options;
  service_options.filter_threads = options.threads;
  absl::StatusOr<std::unique_ptr<Service>> service = Service::Start(service_options);
  if (!service.ok()) return service.status();
  return std::make_unique<EmbeddedFarm>(*std::move(service), options);
}

}  // namespace tessera
