// How many significant bits a stored mean and a stored msd need (docs/decisions/0001): folds a
// million samples of many streams with several roundings and prints the worst errors against
// double-precision sums of the same samples.
//   fold_precision_bench [SAMPLES = 1000000]
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <random>
#include <vector>

#include "core/base/sample_range.h"
#include "core/film/fold.h"

namespace tessera {
namespace {

constexpr int kNumStreams = 64;  // folded side by side

struct Node {
  float mean[kNumStreams] = {};
  float msd[kNumStreams] = {};
};

// The folding tree with means of kMean and msds of kMsd significant bits.
template <int kMean, int kMsd>
class Folder {
 public:
  void Add(const float* samples) {
    Node newest;
    for (int i = 0; i < kNumStreams; ++i) newest.mean[i] = RoundToBits<kMean>(samples[i]);
    int level = 0;
    for (int64_t index = count_++; index & 1; index >>= 1, ++level) {
      Fold(newest, 0.5f, &nodes_[level]);
      newest = nodes_[level];
    }
    nodes_[level] = newest;
  }
  Node Result() const {
    Node result;
    int64_t count = 0;
    for (const SampleRange node : MaximalNodes({0, count_})) {
      const int level = std::countr_zero(static_cast<uint64_t>(node.size()));
      count += node.size();
      const float weight = static_cast<float>(node.size()) / static_cast<float>(count);
      Fold(nodes_[level], weight, &result);
    }
    return result;
  }

 private:
  static void Fold(const Node& right, float right_weight, Node* left) {
    for (int i = 0; i < kNumStreams; ++i) {
      float mean, msd;
      FoldMoments(left->mean[i], left->msd[i], right.mean[i], right.msd[i], right_weight, &mean,
                  &msd);
      left->mean[i] = RoundToBits<kMean>(mean);
      left->msd[i] = RoundToBits<kMsd>(msd);
    }
  }

  Node nodes_[40];
  int64_t count_ = 0;
};

// Sums about a shift near the mean: exact enough in double.
struct Reference {
  double shift = 0;
  double sum[kNumStreams] = {};
  double sum_of_squares[kNumStreams] = {};

  void Add(const float* samples) {
    for (int i = 0; i < kNumStreams; ++i) {
      const double value = samples[i] - shift;
      sum[i] += value;
      sum_of_squares[i] += value * value;
    }
  }
};

void Print(const char* stream, int mean_bits, int msd_bits, const Node& node,
           const Reference& reference, int64_t count) {
  double mean_error = 0, msd_error = 0;
  for (int i = 0; i < kNumStreams; ++i) {
    const double n = static_cast<double>(count);
    const double offset = reference.sum[i] / n;
    const double msd = reference.sum_of_squares[i] / n - offset * offset;
    const double mean = reference.shift + offset;
    mean_error =
        std::fmax(mean_error, std::fabs(node.mean[i] - mean) / (std::fabs(mean) + std::sqrt(msd)));
    msd_error = std::fmax(msd_error, std::fabs(node.msd[i] / msd - 1));
  }
  std::printf("%-24s %9d %8d   %.1e   %.1e\n", stream, mean_bits, msd_bits, mean_error, msd_error);
}

enum class Stream { kNormal, kLognormal, kRare };

void Measure(const char* name, Stream stream, double mean_over_sd, int64_t count) {
  Folder<24, 24> exact;
  Folder<24, 14> msd14;
  Folder<24, 13> msd13;
  Folder<24, 12> msd12;
  Folder<24, 11> msd11;
  Folder<23, 13> mean23;
  Folder<22, 13> mean22;
  Reference reference;
  reference.shift = mean_over_sd;
  std::mt19937_64 random(1);
  std::normal_distribution<float> normal;
  std::uniform_real_distribution<float> uniform;
  for (int64_t i = 0; i < count; ++i) {
    float samples[kNumStreams];
    for (int j = 0; j < kNumStreams; ++j) {
      // Streams differ in scale, so that mantissas of all sizes occur.
      const float scale = 1.0f + static_cast<float>(j) / kNumStreams;
      switch (stream) {
        case Stream::kNormal:
          samples[j] = static_cast<float>(mean_over_sd) + scale * normal(random);
          break;
        case Stream::kLognormal:
          samples[j] = scale * std::exp(1.5f * normal(random));
          break;
        case Stream::kRare:
          samples[j] = uniform(random) < 1e-3f ? scale : 0.0f;
          break;
      }
    }
    reference.Add(samples);
    exact.Add(samples);
    msd14.Add(samples);
    msd13.Add(samples);
    msd12.Add(samples);
    msd11.Add(samples);
    mean23.Add(samples);
    mean22.Add(samples);
  }
  Print(name, 24, 24, exact.Result(), reference, count);
  Print(name, 24, 14, msd14.Result(), reference, count);
  Print(name, 24, 13, msd13.Result(), reference, count);
  Print(name, 24, 12, msd12.Result(), reference, count);
  Print(name, 24, 11, msd11.Result(), reference, count);
  Print(name, 23, 13, mean23.Result(), reference, count);
  Print(name, 22, 13, mean22.Result(), reference, count);
}

}  // namespace
}  // namespace tessera

int main(int argc, char** argv) {
  const int64_t count = argc > 1 ? std::atoll(argv[1]) : 1000000;
  if (count < 2) {
    std::fprintf(stderr, "SAMPLES must be at least 2\n");
    return 2;
  }
  std::printf("stream                   mean bits msd bits mean err  msd err\n");
  using tessera::Stream;
  tessera::Measure("normal, mean/sd 0", Stream::kNormal, 0, count);
  tessera::Measure("normal, mean/sd 1", Stream::kNormal, 1, count);
  tessera::Measure("normal, mean/sd 30", Stream::kNormal, 30, count);
  tessera::Measure("normal, mean/sd 1000", Stream::kNormal, 1000, count);
  tessera::Measure("lognormal, sigma 1.5", Stream::kLognormal, 0, count);
  tessera::Measure("one in 1000", Stream::kRare, 0, count);
}
