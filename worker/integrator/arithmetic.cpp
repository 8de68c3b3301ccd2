#include "worker/integrator/arithmetic.h"

#include <immintrin.h>

#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <string>

#include "absl/strings/str_cat.h"
#include "core/base/check.h"
#include "core/base/isa_level.h"

namespace tessera {
namespace {

// Order matters, a word moves every bit: multiply and fold, after SplitMix64's finaliser (Steele,
// Lea & Flood 2014). Not against somebody who wants a collision: workers are trusted.
void Add(uint64_t word, uint64_t* hash) {
  *hash = (*hash ^ word) * 0x9e3779b97f4a7c15u;
  *hash ^= *hash >> 29;
}

__m128 Reciprocal(__m128 x) { return _mm_rcp_ps(x); }
__m128 ReciprocalRoot(__m128 x) { return _mm_rsqrt_ps(x); }
__attribute__((target("avx512f,avx512vl"))) __m128 Reciprocal14(__m128 x) {
  return _mm_rcp14_ps(x);
}
__attribute__((target("avx512f,avx512vl"))) __m128 ReciprocalRoot14(__m128 x) {
  return _mm_rsqrt14_ps(x);
}

template <typename Approximate>
void AddRange(Approximate approximate, uint64_t begin, uint64_t end, uint64_t step,
              uint64_t* hash) {
  std::array<uint64_t, 4> chains = {1, 2, 3, 4};  // do not wait for each other
  for (uint64_t bits = begin; bits < end; bits += 8 * step) {
    for (size_t half = 0; half < 2; ++half) {
      const auto lane = [&](uint64_t i) { return static_cast<int>(bits + (4 * half + i) * step); };
      const __m128i result = _mm_castps_si128(
          approximate(_mm_castsi128_ps(_mm_setr_epi32(lane(0), lane(1), lane(2), lane(3)))));
      Add(static_cast<uint64_t>(_mm_extract_epi64(result, 0)), &chains[2 * half]);
      Add(static_cast<uint64_t>(_mm_extract_epi64(result, 1)), &chains[2 * half + 1]);
    }
  }
  for (const uint64_t chain : chains) Add(chain, hash);
}

// Every mantissa, at an even and an odd exponent, and some of every exponent and sign.
template <typename Approximate>
void AddApproximation(Approximate approximate, uint64_t* hash) {
  AddRange(approximate, 0x3f800000, 0x40800000, 1, hash);
  AddRange(approximate, 0, 0x100000000, 0x3fff, hash);
}

template <typename Function>
void AddFunction(Function function, uint64_t* hash) {
  for (int i = 1; i <= 4096; ++i) {
    // 0.0007 to 2.8 in steps of no short binary fraction.
    Add(std::bit_cast<uint64_t>(function(i * 0x1.6a09e667f3bcdp-11)), hash);
  }
}

// Those whose results reach a picture: angles of files, tables of colours and logarithms.
void AddMathLibrary(uint64_t* hash) {
  AddFunction([](double x) { return std::sin(x); }, hash);
  AddFunction([](double x) { return std::cos(x); }, hash);
  AddFunction([](double x) { return std::tan(x); }, hash);
  AddFunction([](double x) { return std::log(x); }, hash);
  AddFunction([](double x) { return std::log2(x); }, hash);
  AddFunction([](double x) { return std::exp2(x); }, hash);
  AddFunction([](double x) { return std::pow(x, 2.4); }, hash);
}

std::string TextOf(uint64_t hash) { return absl::StrCat(absl::Hex(hash, absl::kZeroPad16)); }

// Of the classes without AVX-512.
uint64_t ComputeNarrow() {
  uint64_t hash = 1;  // the layout's version
  AddMathLibrary(&hash);
  AddApproximation(Reciprocal, &hash);
  AddApproximation(ReciprocalRoot, &hash);
  return hash;
}

uint64_t ComputeWide(uint64_t narrow) {
  uint64_t hash = narrow;
  AddApproximation(Reciprocal14, &hash);
  AddApproximation(ReciprocalRoot14, &hash);
  return hash;
}

}  // namespace

std::string ArithmeticOf(const std::string& isa_class) {
  TESSERA_CHECK(ProcessorRuns(isa_class));
  static const uint64_t narrow = ComputeNarrow();
  if (isa_class != "x86-64-v4") return TextOf(narrow);
  static const uint64_t wide = ComputeWide(narrow);
  return TextOf(wide);
}

std::string ComputeArithmetic(const std::string& isa_class) {
  TESSERA_CHECK(ProcessorRuns(isa_class));
  const uint64_t narrow = ComputeNarrow();
  return TextOf(isa_class == "x86-64-v4" ? ComputeWide(narrow) : narrow);
}

}  // namespace tessera
