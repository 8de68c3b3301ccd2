// Bytes per pixel of deltas, and nanoseconds per pixel to fold, encode, decode and merge them.
// What passing a film through memory takes is beside them (PassThroughMemory).
// Synthetic tiles: lognormal radiance over textured, tilted surfaces with an edge. A real delta:
//   delta_codec_bench --delta=FILE,WIDTH,HEIGHT,BEGIN,END,F
// (FILE: the bytes of TileDelta.payload; F: its feature_end)
#include <benchmark/benchmark.h>

#include <cmath>
#include <cstdio>
#include <fstream>
#include <iterator>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include "core/film/delta_codec.h"
#include "core/film/pixel_folder.h"

namespace tessera {
namespace {

constexpr int kTilePx = 32;

// One pixel's surface; `smooth` has the features of a flat wall, else every sample's differ.
PixelSample DrawSample(int x, int y, bool smooth, std::mt19937_64& random) {
  std::normal_distribution<float> normal;
  PixelSample sample;
  const bool left = x < 3 * kTilePx / 4;
  const float jitter = smooth ? 0.0f : 1.0f;
  for (int c = 0; c < 3; ++c) {
    sample.albedo[c] =
        0.5f + (left ? 0.2f : -0.1f) * static_cast<float>(c) / 2 + jitter * 0.02f * normal(random);
    sample.radiance[c] = sample.albedo[c] * std::exp(normal(random));
    sample.normal[c] = (left ? 0.57735f : (c == 1 ? 1.0f : 0.0f)) + jitter * 0.01f * normal(random);
  }
  sample.depth =
      4.0f + 0.01f * (static_cast<float>(x) + static_cast<float>(y)) + 0.003f * normal(random);
  sample.material_id = left ? 3 : 7;
  return sample;
}

TileStatistics SyntheticTile(SampleRange range, int64_t feature_end, bool smooth, uint64_t seed) {
  std::mt19937_64 random(seed);
  TileStatistics tile(PixelRect::FromSize(0, 0, kTilePx, kTilePx), range, feature_end);
  PixelFolder folder;
  for (int y = 0; y < kTilePx; ++y) {
    for (int x = 0; x < kTilePx; ++x) {
      folder.Begin(x, y, range, feature_end);
      for (int64_t i = 0; i < range.size(); ++i) folder.Add(DrawSample(x, y, smooth, random));
      folder.Store(&tile);
    }
  }
  return tile;
}

// Reports the time of an iteration divided by `count`.
void SetNanosecondsPer(const std::string& unit, int64_t count, benchmark::State& state) {
  // Google Benchmark inverts a rate to seconds; 1e-9 of the count makes them nanoseconds.
  state.counters["ns/" + unit] = benchmark::Counter(
      static_cast<double>(count) * 1e-9,
      benchmark::Counter::kIsIterationInvariantRate | benchmark::Counter::kInvert);
}
void SetPerPixel(benchmark::State& state, int64_t num_pixels) {
  SetNanosecondsPer("px", num_pixels, state);
}

void Encode(benchmark::State& state, const TileStatistics& tile, DeltaEncoding encoding) {
  EncodedDelta delta;
  for (auto _ : state) delta = EncodeDelta(tile, encoding);
  SetPerPixel(state, tile.num_pixels());
  const double num_pixels = static_cast<double>(tile.num_pixels());
  state.counters["B/px"] = static_cast<double>(delta.payload.size()) / num_pixels;
  state.counters["B/px packed"] = static_cast<double>(delta.payload_bytes) / num_pixels;
}

void Decode(benchmark::State& state, const TileStatistics& tile, DeltaEncoding encoding) {
  const EncodedDelta delta = EncodeDelta(tile, encoding);
  for (auto _ : state) {
    const auto decoded = DecodeDelta(tile.window(), tile.range(), tile.feature_end(),
                                     static_cast<uint32_t>(encoding), delta.payload);
    benchmark::DoNotOptimize(decoded.ok());
  }
  SetPerPixel(state, tile.num_pixels());
}

void RegisterCodec(const std::string& name, const TileStatistics& tile) {
  for (const auto& [encoding, suffix] : {std::pair(DeltaEncoding::kPacked, "packed"),
                                         std::pair(DeltaEncoding::kPackedZstd, "zstd"),
                                         std::pair(DeltaEncoding::kPackedBlocks, "blocks")}) {
    benchmark::RegisterBenchmark(("Encode/" + name + "/" + suffix).c_str(), Encode, tile, encoding);
    benchmark::RegisterBenchmark(("Decode/" + name + "/" + suffix).c_str(), Decode, tile, encoding);
  }
}

// Argument: where features end, 16 for a right side without them.
void Merge(benchmark::State& state) {
  const int64_t feature_end = state.range(0);
  const TileStatistics left = SyntheticTile({0, 16}, feature_end, false, 1);
  const TileStatistics right = SyntheticTile({16, 32}, feature_end, false, 2);
  TileStatistics joint = left;
  for (auto _ : state) {
    state.PauseTiming();
    joint = left;
    state.ResumeTiming();
    joint.Merge(right);
  }
  SetPerPixel(state, left.num_pixels());
}

// What any fold of a film larger than the caches takes at least: each byte of a pixel is read and
// written once.
void PassThroughMemory(benchmark::State& state) {
  constexpr int64_t kNumPixels = 512 << 10;
  constexpr int64_t kNumPlanes = kNumHalves * (kNumFloatPlanes + int{kNumCountPlanes});
  std::vector<float> film(static_cast<size_t>(kNumPixels * kNumPlanes));
  for (auto _ : state) {
    for (float& value : film) value += 1.0f;
    benchmark::ClobberMemory();
  }
  SetPerPixel(state, kNumPixels);
}

// Arguments: samples, and where features end.
void AddSamples(benchmark::State& state) {
  const int64_t num_samples = state.range(0), feature_end = state.range(1);
  std::mt19937_64 random(1);
  std::vector<PixelSample> samples;
  for (int64_t i = 0; i < num_samples; ++i) samples.push_back(DrawSample(0, 0, false, random));
  TileStatistics tile(PixelRect::FromSize(0, 0, 1, 1), {0, num_samples}, feature_end);
  PixelFolder folder;
  for (auto _ : state) {
    folder.Begin(0, 0, tile.range(), feature_end);
    for (const PixelSample& sample : samples) folder.Add(sample);
    folder.Store(&tile);
  }
  SetNanosecondsPer("sample", num_samples, state);
}

BENCHMARK(Merge)->Arg(16)->Arg(kAllFeatures)->Iterations(20000);
BENCHMARK(PassThroughMemory);
BENCHMARK(AddSamples)
    ->Args({4, kAllFeatures})
    ->Args({16, kAllFeatures})
    ->Args({64, kAllFeatures})
    ->Args({1024, kAllFeatures})
    ->Args({1024, 64});

// Reads "FILE,WIDTH,HEIGHT,BEGIN,END,F".
std::optional<TileStatistics> ReadDelta(const std::string& argument) {
  const size_t comma = argument.find(',');
  int width, height;
  long long begin, end, feature_end;
  if (comma == std::string::npos || std::sscanf(argument.c_str() + comma, ",%d,%d,%lld,%lld,%lld",
                                                &width, &height, &begin, &end, &feature_end) != 5) {
    return std::nullopt;
  }
  std::ifstream file(argument.substr(0, comma), std::ios::binary);
  const std::string payload{std::istreambuf_iterator<char>(file), {}};
  for (const uint32_t encoding : {1u, 2u, 3u}) {
    auto tile = DecodeDelta(PixelRect::FromSize(0, 0, width, height), {begin, end}, feature_end,
                            encoding, payload);
    if (tile.ok()) return *std::move(tile);
  }
  return std::nullopt;
}

}  // namespace
}  // namespace tessera

int main(int argc, char** argv) {
  using tessera::kAllFeatures;
  using tessera::RegisterCodec;
  using tessera::SyntheticTile;
  std::vector<char*> arguments;
  for (int i = 0; i < argc; ++i) {
    const std::string argument = argv[i];
    if (!argument.starts_with("--delta=")) {
      arguments.push_back(argv[i]);
      continue;
    }
    const auto tile = tessera::ReadDelta(argument.substr(8));
    if (!tile) {
      std::fprintf(stderr, "%s: not a delta of that size and range\n", argument.c_str());
      return 2;
    }
    RegisterCodec(argument.substr(8), *tile);
  }
  for (const int64_t num_samples : {1, 4, 16, 64}) {
    const std::string name = std::to_string(num_samples);
    RegisterCodec("smooth/" + name, SyntheticTile({0, num_samples}, kAllFeatures, true, 1));
    RegisterCodec("rough/" + name, SyntheticTile({0, num_samples}, kAllFeatures, false, 1));
    RegisterCodec("settled/" + name,
                  SyntheticTile({num_samples, 2 * num_samples}, num_samples, false, 1));
  }
  int num_arguments = static_cast<int>(arguments.size());
  benchmark::Initialize(&num_arguments, arguments.data());
  benchmark::RunSpecifiedBenchmarks();
}
