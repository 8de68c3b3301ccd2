// What a filter needs beyond its input and output does not grow with the frame: the peak of the
// heap while one window is filtered, counted by replacing operator new in this program.
#include <malloc.h>

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <cstdlib>
#include <new>
#include <string>

#include "core/denoise/denoise_frame.h"
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

// The bytes that filtering the middle window of a frame needs at most.
int64_t PeakBytes(const Denoiser& denoiser, int frame_side) {
  FramePlanes planes(PixelRect{0, 0, frame_side, frame_side});
  std::ranges::fill(planes.samples, 4u);
  const int side = denoiser.window_px(DenoiseQuality::kFinal);
  const PixelRect window =
      PixelRect::FromSize((frame_side - side) / 2, (frame_side - side) / 2, side, side);
  FilteredPlanes out(window);
  const int64_t before = heap_bytes;
  heap_bytes_max = before;
  denoiser.Filter(planes, {planes.bounds, DenoiseQuality::kFinal}, window, &out);
  return heap_bytes_max - before;
}

TEST(FilterMemory, DoesNotGrowWithTheFrame) {
  for (const std::string& name : DenoiserNames()) {
    const auto denoiser = *MakeDenoiser(name);
    const int64_t peak = PeakBytes(*denoiser, 400);
    // What lies within the halo is the same, but for some lists of pixels.
    EXPECT_NEAR(static_cast<double>(PeakBytes(*denoiser, 520)), static_cast<double>(peak),
                0.01 * static_cast<double>(peak)) << name;
    RecordProperty(name, std::to_string(peak));
    // Of `regression`, 37 MB: for each thread, so two threads stay below 200 bytes a pixel from
    // frames of 820x460 on, and do not below.
    EXPECT_LT(peak, 42'000'000) << name;
  }
}

}  // namespace
}  // namespace tessera
