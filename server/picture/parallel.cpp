#include "server/picture/parallel.h"

#include <time.h>

#include <algorithm>
#include <atomic>
#include <numeric>
#include <thread>
#include <vector>

namespace tessera {
namespace {

double ThreadCpuSeconds() {
  timespec now = {};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

}  // namespace

double ParallelFor(size_t count, int num_threads, const std::function<void(size_t)>& body) {
  const size_t num_workers = std::min(count, static_cast<size_t>(std::max(1, num_threads)));
  if (num_workers == 0) return 0;
  std::vector<double> seconds(num_workers);
  std::atomic<size_t> next{0};
  const auto work = [&](size_t worker) {
    const double begin = ThreadCpuSeconds();
    for (size_t i = next++; i < count; i = next++) body(i);
    seconds[worker] = ThreadCpuSeconds() - begin;
  };
  std::vector<std::thread> threads;
  for (size_t worker = 1; worker < num_workers; ++worker) threads.emplace_back(work, worker);
  work(0);
  for (std::thread& thread : threads) thread.join();
  return std::accumulate(seconds.begin(), seconds.end(), 0.0);
}

}  // namespace tessera
