// tessera-worker around a path tracer that breaks on purpose (faulty_renderer.h); for tests only.
#include <csignal>
#include <cstdlib>
#include <limits>
#include <new>
#include <thread>
#include <utility>
#include <vector>

#include "tests/integration/faulty_renderer.h"
#include "worker/session/path_tracer_renderer.h"
#include "worker/session/worker_program.h"

namespace tessera {
namespace {

class FaultyRenderer : public Renderer {
 public:
  FaultyRenderer(std::unique_ptr<Renderer> sound, uint64_t seed)
      : sound_(std::move(sound)), seed_(seed) {}

  absl::StatusOr<TileStatistics> Render(const PixelRect& window, SampleRange node,
                                        const std::atomic<bool>* cancel,
                                        RenderCounters* counters) const override {
    if (window.x_begin == 0 && window.y_begin == 0 && node.begin == 0) Break(*cancel);
    return sound_->Render(window, node, cancel, counters);
  }
  v1::SceneReport Report() const override { return sound_->Report(); }
  int64_t memory_bytes() const override { return sound_->memory_bytes(); }
  int max_depth() const override { return sound_->max_depth(); }

 private:
  // In a control group of less memory than that the kernel kills the process.
  static void EatMemory(const std::atomic<bool>& cancel) {
    constexpr size_t kBlockBytes = 1 << 20;
    std::vector<std::vector<char>> eaten;
    while (eaten.size() < 1024 && !cancel) eaten.emplace_back(kBlockBytes, 'x');
    while (!cancel) std::this_thread::yield();
  }
  void Break(const std::atomic<bool>& cancel) const {
    if (seed_ == kSeedThatCrashes) raise(SIGSEGV);
    if (seed_ == kSeedThatExhaustsMemory) throw std::bad_alloc();
    if (seed_ == kSeedThatEatsMemory) EatMemory(cancel);
    while (seed_ == kSeedThatHangs && !cancel) std::this_thread::yield();
  }

  const std::unique_ptr<Renderer> sound_;
  const uint64_t seed_;
};

class FaultyFactory : public RendererFactory {
 public:
  absl::StatusOr<std::unique_ptr<Renderer>> Build(const v1::JobSettings& settings,
                                                  int64_t memory_max_bytes, int threads,
                                                  const AssetReader& read_asset) override {
    if (settings.seed() == kSeedThatCrashesBuilds) std::abort();
    auto sound = sound_->Build(settings, memory_max_bytes, threads, read_asset);
    if (!sound.ok()) return sound.status();
    return std::make_unique<FaultyRenderer>(*std::move(sound), settings.seed());
  }

 private:
  const std::unique_ptr<RendererFactory> sound_ = MakePathTracerFactory();
};

}  // namespace
}  // namespace tessera

int main(int argc, char** argv) {
  return tessera::RunWorkerProgram(argc, argv,
                                   [] { return std::make_unique<tessera::FaultyFactory>(); });
}
