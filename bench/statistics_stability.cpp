// Where one-pass statistics go wrong: feeds the same float samples to several accumulators and
// prints, as CSV, their errors against shifted sums in long double (docs/stability.md).
// Welford 1962; Chan, Golub & LeVeque 1983; the film's fold is core/film/fold.h.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <limits>
#include <memory>
#include <numeric>
#include <string>
#include <vector>

#include "core/base/check.h"
#include "core/film/fold.h"
#include "core/film/node_rounding.h"
#include "core/film/pixel_folder.h"

namespace tessera {
namespace {

struct Estimate {
  double mean = 0;
  double variance = 0;  // of the samples, m2 / (n - 1)
};

// A one-pass accumulator. Merge takes another of the same kind; the talk's has none.
class Accumulator {
 public:
  virtual ~Accumulator() = default;
  // The index of the first sample, where it matters; 0 otherwise.
  virtual void Begin(int64_t /*first*/) {}
  virtual void Add(float x) = 0;
  virtual bool Merge(const Accumulator& right) = 0;
  virtual Estimate Result() const = 0;
};

template <typename Real>
class Sums final : public Accumulator {
 public:
  void Add(float x) override {
    ++count_;
    sum_ += static_cast<Real>(x);
    squares_ += static_cast<Real>(x) * static_cast<Real>(x);
  }
  bool Merge(const Accumulator& right) override {
    const auto& other = static_cast<const Sums&>(right);
    count_ += other.count_;
    sum_ += other.sum_;
    squares_ += other.squares_;
    return true;
  }
  Estimate Result() const override {
    const Real n = static_cast<Real>(count_);
    return {static_cast<double>(sum_ / n),
            static_cast<double>((squares_ - sum_ * sum_ / n) / static_cast<Real>(count_ - 1))};
  }

 private:
  int64_t count_ = 0;
  Real sum_ = 0, squares_ = 0;
};

// The natural reading of "the previous mean and variance are retained, the new sample is folded in
// directly": an exact running mean, and a running mean of the squared distance from it.
class Talk final : public Accumulator {
 public:
  void Add(float x) override {
    ++count_;
    const float n = static_cast<float>(count_);
    mean_ += (x - mean_) / n;
    const float d = x - mean_;
    variance_ += (d * d - variance_) / n;
  }
  bool Merge(const Accumulator& /*right*/) override { return false; }
  Estimate Result() const override { return {mean_, variance_}; }

 private:
  int64_t count_ = 0;
  float mean_ = 0, variance_ = 0;
};

template <typename Real>
class Welford final : public Accumulator {
 public:
  void Add(float x) override {
    ++count_;
    const Real d = static_cast<Real>(x) - mean_;
    mean_ += d / static_cast<Real>(count_);
    m2_ += d * (static_cast<Real>(x) - mean_);
  }
  bool Merge(const Accumulator& right) override {
    const auto& other = static_cast<const Welford&>(right);
    const Real n = static_cast<Real>(count_ + other.count_);
    const Real d = other.mean_ - mean_;
    mean_ += d * static_cast<Real>(other.count_) / n;
    m2_ += other.m2_ + d * d * static_cast<Real>(count_) * static_cast<Real>(other.count_) / n;
    count_ += other.count_;
    return true;
  }
  Estimate Result() const override {
    return {static_cast<double>(mean_), static_cast<double>(m2_ / static_cast<Real>(count_ - 1))};
  }

 private:
  int64_t count_ = 0;
  Real mean_ = 0, m2_ = 0;
};

// One pixel and channel of the film: a binary tree over sample indices, whose nodes hold two
// halves; Merge takes the samples that follow, and replays the tree over whole nodes.
class FilmFold final : public Accumulator {
 public:
  void Begin(int64_t first) override { begin_ = end_ = first; }
  void Add(float x) override {
    PixelSample sample;
    sample.radiance[0] = x;
    ReplaceNonFinite(&sample);
    Node node;
    node.range = {end_, end_ + 1};
    node.half[end_ & 1].mean = sample.radiance[0];
    Append(node);
  }
  bool Merge(const Accumulator& right) override {
    const auto& other = static_cast<const FilmFold&>(right);
    TESSERA_CHECK(other.begin_ == end_);
    for (const Node& node : other.nodes_) Append(node);
    return true;
  }
  Estimate Result() const override {
    Node all = nodes_.front();
    for (size_t i = 1; i < nodes_.size(); ++i) all = Join(all, nodes_[i]);
    const int64_t count_a = all.range.HalfCount(0), count_b = all.range.HalfCount(1);
    HalfMoments joint;
    FoldMoments(all.half[0].mean, all.half[0].msd, all.half[1].mean, all.half[1].msd,
                RightWeight(static_cast<int32_t>(count_a), static_cast<int32_t>(count_b)),
                &joint.mean, &joint.msd);
    const double count = static_cast<double>(count_a + count_b);
    return {joint.mean, static_cast<double>(joint.msd) * count / (count - 1.0)};
  }

 private:
  struct HalfMoments {
    float mean = 0, msd = 0;
  };
  struct Node {
    SampleRange range;
    HalfMoments half[kNumHalves];
  };

  static Node Join(const Node& left, const Node& right) {
    Node joint;
    joint.range = {left.range.begin, right.range.end};
    for (int h = 0; h < kNumHalves; ++h) {
      FoldMoments(left.half[h].mean, left.half[h].msd, right.half[h].mean, right.half[h].msd,
                  RightWeight(static_cast<int32_t>(left.range.HalfCount(h)),
                              static_cast<int32_t>(right.range.HalfCount(h))),
                  &joint.half[h].mean, &joint.half[h].msd);
      joint.half[h].msd = RoundMsd(joint.half[h].msd);
    }
    const NodeRounding rounding = RoundingOf(joint.range, false);
    if (rounding.kind == NodeRounding::Kind::kNone) return joint;
    Moments8 halves[kNumHalves] = {};
    for (int h = 0; h < kNumHalves; ++h) {
      halves[h].mean[0] = joint.half[h].mean;
      halves[h].msd[0] = joint.half[h].msd;
    }
    RoundHalves(rounding, UInt8{} + PixelHash(0, 0), &halves[0], &halves[1]);
    for (int h = 0; h < kNumHalves; ++h) {
      joint.half[h] = {halves[h].mean[0], halves[h].msd[0]};
    }
    return joint;
  }
  void Append(Node node) {
    end_ = node.range.end;
    while (!nodes_.empty() && nodes_.back().range.size() == node.range.size() &&
           nodes_.back().range.begin % (2 * node.range.size()) == 0) {
      node = Join(nodes_.back(), node);
      nodes_.pop_back();
    }
    nodes_.push_back(node);
  }

  int64_t begin_ = 0, end_ = 0;
  std::vector<Node> nodes_;  // what waits for a sibling, largest first
};

struct Method {
  std::string name;
  std::function<std::unique_ptr<Accumulator>()> make;
};

const std::vector<Method>& Methods() {
  static const std::vector<Method> kMethods = {
      {"sums float", [] { return std::make_unique<Sums<float>>(); }},
      {"sums double", [] { return std::make_unique<Sums<double>>(); }},
      {"talk float", [] { return std::make_unique<Talk>(); }},
      {"Welford float", [] { return std::make_unique<Welford<float>>(); }},
      {"Welford double", [] { return std::make_unique<Welford<double>>(); }},
      {"film", [] { return std::make_unique<FilmFold>(); }}};
  return kMethods;
}

// Exact to about 1e-17: sums of the distance from a value near the mean.
class Reference {
 public:
  explicit Reference(double near_mean) : shift_(near_mean) {}
  void Add(float x) {
    const long double d = static_cast<long double>(x) - shift_;
    ++count_;
    sum_ += d;
    squares_ += d * d;
  }
  Estimate Result() const {
    const long double n = static_cast<long double>(count_);
    const long double variance = count_ > 1 ? (squares_ - sum_ * sum_ / n) / (n - 1) : 0;
    return {static_cast<double>(shift_ + sum_ / n), static_cast<double>(std::max(variance, 0.0L))};
  }

 private:
  long double shift_;
  int64_t count_ = 0;
  long double sum_ = 0, squares_ = 0;
};

// Uniform in [0, 1), by SplitMix64 (Steele, Lea & Flood 2014).
class Uniform {
 public:
  explicit Uniform(uint64_t seed) : state_(seed) {}
  double Next() {
    uint64_t z = (state_ += 0x9e3779b97f4a7c15u);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return static_cast<double>((z ^ (z >> 31)) >> 11) * 0x1p-53;
  }

 private:
  uint64_t state_;
};

// Of one cell. The mean's is relative to |mean| + sd, the variance's to the variance; where that is
// 0, to mean^2. Infinite for what is not finite.
struct Errors {
  double mean = 0;
  double variance = 0;
};

Errors ErrorsOf(const Estimate& found, const Estimate& truth) {
  const double scale = std::abs(truth.mean) + std::sqrt(truth.variance);
  const double unit = truth.variance > 0 ? truth.variance : truth.mean * truth.mean;
  Errors errors = {std::abs(found.mean - truth.mean) / (scale > 0 ? scale : 1),
                   std::abs(found.variance - truth.variance) / (unit > 0 ? unit : 1)};
  if (!std::isfinite(errors.mean)) errors.mean = std::numeric_limits<double>::infinity();
  if (!std::isfinite(errors.variance)) errors.variance = std::numeric_limits<double>::infinity();
  return errors;
}

void PrintRow(const std::string& experiment, const std::string& method, const std::string& x,
              const Errors& errors, double variance) {
  std::printf("%s,%s,%s,%.3g,%.3g,%d\n", experiment.c_str(), method.c_str(), x.c_str(), errors.mean,
              errors.variance, variance < 0 ? 1 : 0);
}

using Stream = std::function<float(int64_t)>;  // sample i; called in order

// The worst of each method's cells at each of the counts, over streams made by `make(seed)`.
void Measure(const std::string& experiment, const std::vector<std::string>& xs,
             const std::vector<int64_t>& counts, int num_streams, double near_mean,
             const std::function<Stream(uint64_t)>& make) {
  const size_t num_methods = Methods().size();
  std::vector<Errors> worst(num_methods * counts.size());
  std::vector<double> least_variance(worst.size(), 0);
  for (int stream = 0; stream < num_streams; ++stream) {
    const Stream next = make(static_cast<uint64_t>(stream) + 1);
    std::vector<std::unique_ptr<Accumulator>> accumulators;
    for (const Method& method : Methods()) accumulators.push_back(method.make());
    Reference reference(near_mean);
    int64_t i = 0;
    for (size_t at = 0; at < counts.size(); ++at) {
      for (; i < counts[at]; ++i) {
        const float x = next(i);
        PixelSample sample;
        sample.radiance[0] = x;
        ReplaceNonFinite(&sample);
        reference.Add(sample.radiance[0]);
        for (const auto& accumulator : accumulators) accumulator->Add(x);
      }
      const Estimate truth = reference.Result();
      for (size_t m = 0; m < num_methods; ++m) {
        const Estimate found = accumulators[m]->Result();
        const Errors errors = ErrorsOf(found, truth);
        Errors& cell = worst[at * num_methods + m];
        cell = {std::max(cell.mean, errors.mean), std::max(cell.variance, errors.variance)};
        double& least = least_variance[at * num_methods + m];
        least = std::min(least, found.variance);
      }
    }
  }
  for (size_t at = 0; at < counts.size(); ++at) {
    for (size_t m = 0; m < num_methods; ++m) {
      const size_t cell = at * num_methods + m;
      PrintRow(experiment, Methods()[m].name, xs[at], worst[cell], least_variance[cell]);
    }
  }
  std::fflush(stdout);
}

std::string PowerOfTen(int exponent) { return "1e" + std::to_string(exponent); }

Stream NoiseAround(double mean, double sd, uint64_t seed) {
  auto uniform = std::make_shared<Uniform>(seed);
  return [=](int64_t) {
    return static_cast<float>(mean + sd * std::sqrt(12.0) * (uniform->Next() - 0.5));
  };
}

// From 2 samples on, for one has no variance; 8 streams as far as 10^7 samples, one beyond.
void MeasureCounts(int64_t samples_max) {
  std::vector<std::string> xs[2];
  std::vector<int64_t> counts[2];
  int64_t count = 10;
  for (int exponent = 1; count <= samples_max; ++exponent, count *= 10) {
    const int group = exponent <= 7 ? 0 : 1;
    xs[group].push_back(PowerOfTen(exponent));
    counts[group].push_back(count);
  }
  for (int group = 0; group < 2; ++group) {
    Measure("samples", xs[group], counts[group], group == 0 ? 8 : 1, 1.0,
            [](uint64_t seed) { return NoiseAround(1, 1, seed); });
  }
}

void MeasureRatios(int64_t count) {
  for (int exponent = 0; exponent <= 8; ++exponent) {
    const double mean = std::pow(10.0, exponent);
    Measure("mean/sd", {PowerOfTen(exponent)}, {count}, 8, mean,
            [mean](uint64_t seed) { return NoiseAround(mean, 1, seed); });
  }
}

void MeasureCases(int64_t count) {
  const auto measure = [count](const std::string& name, double near_mean,
                               const std::function<Stream(uint64_t)>& make) {
    Measure("case", {name}, {count}, 4, near_mean, make);
  };
  struct Place {
    std::string name;
    int64_t index;
  };
  const Place places[] = {{"first", 0}, {"in the middle", count / 2}, {"last", count - 1}};
  for (const double outlier : {1e4, 1e8}) {
    for (const Place& place : places) {
      measure((outlier > 1e6 ? "outlier 1e8 " : "outlier 1e4 ") + place.name, 0.5,
              [=](uint64_t seed) {
                const Stream noise = NoiseAround(0.5, 0.3, seed);
                return [=](int64_t i) {
                  const float x = noise(i);
                  return i == place.index ? static_cast<float>(outlier) : x;
                };
              });
    }
  }
  measure("constant 0.1", 0.1f, [](uint64_t) { return [](int64_t) { return 0.1f; }; });
  measure("constant 12345.6", 12345.6f, [](uint64_t) { return [](int64_t) { return 12345.6f; }; });
  measure("denormals", 0, [](uint64_t seed) {
    const Stream noise = NoiseAround(0.5, 0.3, seed);
    return [=](int64_t i) { return noise(i) * 1e-40f; };
  });
  measure("tiny (1e-18)", 0.5e-18, [](uint64_t seed) {
    const Stream noise = NoiseAround(0.5, 0.3, seed);
    return [=](int64_t i) { return noise(i) * 1e-18f; };
  });
  measure("huge (2^59)", 0.5 * 0x1p59, [](uint64_t seed) {
    const Stream noise = NoiseAround(0.5, 0.3, seed);
    return [=](int64_t i) { return noise(i) * 0x1p59f; };
  });
  measure("alternating signs", 0, [](uint64_t seed) {
    const Stream noise = NoiseAround(1000, 1, seed);
    return [=](int64_t i) { return i % 2 == 0 ? noise(i) : -noise(i); };
  });
  measure("one sample in 1000 lit", 0.001, [](uint64_t seed) {
    auto uniform = std::make_shared<Uniform>(seed);
    return [=](int64_t) { return uniform->Next() < 0.001 ? 1.0f : 0.0f; };
  });
  const auto replaced = [&](const std::string& name, float value) {
    measure(name, 0.5, [=](uint64_t seed) {
      const Stream noise = NoiseAround(0.5, 0.3, seed);
      return [=](int64_t i) {
        const float x = noise(i);
        return i == count / 3 ? value : x;
      };
    });
  };
  replaced("one NaN", std::numeric_limits<float>::quiet_NaN());
  replaced("one infinity", std::numeric_limits<float>::infinity());
}

// Deliveries of 1024 samples each arrive in any order. The film sorts them into its tree by their
// range; the others merge as they come. Error of the worst of 16 orders; "spread" is how far the
// orders are apart.
void MeasureArrival(int64_t count, double mean) {
  constexpr int64_t kDelivery = 1024;
  constexpr int kNumOrders = 16;
  const Stream next = NoiseAround(mean, 1, 77);
  const int64_t num_deliveries = count / kDelivery;
  std::vector<std::vector<std::unique_ptr<Accumulator>>> parts(Methods().size());
  Reference reference(mean);
  for (int64_t d = 0; d < num_deliveries; ++d) {
    for (size_t m = 0; m < Methods().size(); ++m) {
      parts[m].push_back(Methods()[m].make());
      parts[m].back()->Begin(d * kDelivery);
    }
    for (int64_t i = 0; i < kDelivery; ++i) {
      const float x = next(i);
      reference.Add(x);
      for (auto& of_method : parts) of_method.back()->Add(x);
    }
  }
  const Estimate truth = reference.Result();
  const std::string name = mean > 1 ? " (mean/sd 1000)" : " (mean/sd 1)";
  for (size_t m = 0; m < Methods().size(); ++m) {
    const bool is_film = Methods()[m].name == "film";
    Errors worst, spread;
    Estimate least = {1e300, 1e300}, greatest = {-1e300, -1e300};
    bool merges = true;
    for (int order = 0; order < kNumOrders && merges; ++order) {
      std::vector<size_t> arrival(static_cast<size_t>(num_deliveries));
      std::iota(arrival.begin(), arrival.end(), size_t{0});
      Uniform uniform(static_cast<uint64_t>(order) + 1);
      for (size_t i = arrival.size(); i > 1; --i) {
        const auto other = static_cast<size_t>(uniform.Next() * static_cast<double>(i));
        std::swap(arrival[i - 1], arrival[other]);
      }
      if (is_film) std::ranges::sort(arrival);
      const std::unique_ptr<Accumulator> all = Methods()[m].make();
      for (const size_t d : arrival) merges = merges && all->Merge(*parts[m][d]);
      if (!merges) break;
      const Estimate found = all->Result();
      const Errors errors = ErrorsOf(found, truth);
      worst = {std::max(worst.mean, errors.mean), std::max(worst.variance, errors.variance)};
      least = {std::min(least.mean, found.mean), std::min(least.variance, found.variance)};
      greatest = {std::max(greatest.mean, found.mean), std::max(greatest.variance, found.variance)};
    }
    if (!merges) {
      worst = spread = {std::numeric_limits<double>::infinity(),
                        std::numeric_limits<double>::infinity()};
    } else {
      spread = {(greatest.mean - least.mean) / (std::abs(truth.mean) + std::sqrt(truth.variance)),
                (greatest.variance - least.variance) / truth.variance};
    }
    PrintRow("case", Methods()[m].name, "merged in any order" + name, worst, least.variance);
    PrintRow("spread", Methods()[m].name, "merged in any order" + name, spread, least.variance);
  }
}

// A long stream, to which the next 1000 samples are merged one by one.
void MeasureUnbalanced(int64_t count) {
  const Stream next = NoiseAround(1, 1, 99);
  Reference reference(1);
  std::vector<std::unique_ptr<Accumulator>> accumulators;
  for (const Method& method : Methods()) accumulators.push_back(method.make());
  for (int64_t i = 0; i < count + 1000; ++i) {
    const float x = next(i);
    reference.Add(x);
    for (size_t m = 0; m < accumulators.size(); ++m) {
      // The film takes every sample by its index; a merge of one is its normal way.
      if (i < count || Methods()[m].name == "film") {
        accumulators[m]->Add(x);
      } else {
        const std::unique_ptr<Accumulator> one = Methods()[m].make();
        one->Add(x);
        accumulators[m]->Merge(*one);
      }
    }
  }
  const Estimate truth = reference.Result();
  for (size_t m = 0; m < accumulators.size(); ++m) {
    const bool merges = Methods()[m].name != "talk float";
    const double infinity = std::numeric_limits<double>::infinity();
    PrintRow("case", Methods()[m].name, "1000 merges of one sample",
             merges ? ErrorsOf(accumulators[m]->Result(), truth) : Errors{infinity, infinity}, 0);
  }
}

// What is charted as the film is the film: the same bits as the renderer's PixelFolder.
void CheckAgainstPixelFolder() {
  constexpr int64_t kCount = 4096;
  PixelFolder folder;
  folder.Begin(0, 0, {0, kCount});
  FilmFold fold;
  const Stream next = NoiseAround(3, 1, 5);
  for (int64_t i = 0; i < kCount; ++i) {
    PixelSample sample;
    sample.radiance[0] = next(i);
    folder.Add(sample);
    fold.Add(sample.radiance[0]);
  }
  TileStatistics tile({0, 0, 1, 1}, {0, kCount});
  folder.Store(&tile);
  float mean = 0, msd = 0;
  FoldMoments(tile.Floats(0, kRadianceMean)[0], tile.Floats(0, kRadianceMsd)[0],
              tile.Floats(1, kRadianceMean)[0], tile.Floats(1, kRadianceMsd)[0], 0.5f, &mean, &msd);
  const Estimate found = fold.Result();
  TESSERA_CHECK(found.mean == static_cast<double>(mean));
  TESSERA_CHECK(found.variance == static_cast<double>(msd) * kCount / (kCount - 1.0));
}

}  // namespace
}  // namespace tessera

int main(int argc, char** argv) {
  const int64_t samples_max = argc > 1 ? std::atoll(argv[1]) : 1000000;
  if (samples_max < 10000 || samples_max > 1000000000) {
    std::fprintf(stderr, "usage: statistics_stability [SAMPLES_MAX, 10000 to 1000000000]\n");
    return 2;
  }
  tessera::CheckAgainstPixelFolder();
  const int64_t count = std::min<int64_t>(samples_max, 1 << 20);
  std::printf("experiment,method,x,mean_error,variance_error,negative\n");
  tessera::MeasureRatios(count);
  tessera::MeasureCases(count);
  tessera::MeasureArrival(count, 1);
  tessera::MeasureArrival(count, 1000);
  tessera::MeasureUnbalanced(std::min<int64_t>(samples_max, 100000000));
  tessera::MeasureCounts(samples_max);
  return 0;
}
