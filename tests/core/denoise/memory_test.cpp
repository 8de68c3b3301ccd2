// What a filter needs beyond its input and output: the peak of the heap, counted by replacing
// operator new in this program.
#include <malloc.h>

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <cstdlib>
#include <functional>
#include <new>
#include <string>

#include "core/denoise/frame_filter.h"
#include "gtest/gtest.h"

namespace {

std::atomic<int64_t> heap_bytes = 0;
std::atomic<int64_t> heap_bytes_max = 0;

}  // namespace

void* operator new(size_t size) {
  void* memory = std::malloc(size);
  if (memory == nullptr) std::abort();
  const int64_t now = heap_bytes += static_cast<int64_t>(malloc_usable_size(memory));
  int64_t most = heap_bytes_max;
  while (now > most && !heap_bytes_max.compare_exchange_weak(most, now)) {
  }
  return memory;
}

void operator delete(void* memory) noexcept {
  if (memory == nullptr) return;
  heap_bytes -= static_cast<int64_t>(malloc_usable_size(memory));
  std::free(memory);
}

void operator delete(void* memory, size_t /*size*/) noexcept { operator delete(memory); }

namespace tessera {
namespace {

// The bytes that filtering a frame on one thread needs at most beyond its input and output, what is
// kept for the next time included.
int64_t PeakBytes(const Denoiser& denoiser, int frame_side) {
  FramePlanes planes(PixelRect{0, 0, frame_side, frame_side});
  std::ranges::fill(planes.samples, 4u);
  const auto one_by_one = [](size_t count, const std::function<void(size_t)>& body) {
    for (size_t i = 0; i < count; ++i) body(i);
  };
  const int64_t before = heap_bytes;
  heap_bytes_max = before;
  const auto filter =
      denoiser.MakeFrameFilter({planes.bounds, DenoiseQuality::kFinal}, planes.bounds);
  filter->Filter(planes, {&planes.bounds, 1}, one_by_one, [](const FilteredPlanes&) {});
  return heap_bytes_max - before;
}

// At most 160 bytes a pixel for what is kept, and 24 MB for each thread.
TEST(FilterMemory, IsBounded) {
  for (const std::string& name : DenoiserNames()) {
    const auto denoiser = *MakeDenoiser(name);
    for (const int64_t side : {64, 256, 600}) {
      if (side == 600 && name != DenoiserNames().front()) continue;
      const int64_t peak = PeakBytes(*denoiser, static_cast<int>(side));
      RecordProperty(name + std::to_string(side), std::to_string(peak));
      EXPECT_LT(peak, 160 * side * side + 24'000'000) << name << ' ' << side;
    }
  }
}

}  // namespace
}  // namespace tessera
