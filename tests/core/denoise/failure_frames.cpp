#include "tests/core/denoise/failure_frames.h"

#include <array>
#include <cmath>
#include <functional>

namespace tessera {
namespace {

using Rgb = std::array<float, 3>;

// What one sample of a pixel finds.
struct Sample {
  Rgb color;
  Rgb albedo = {0.5f, 0.5f, 0.5f};
  Rgb normal = {0, 0, 1};
  float depth = 4;
};

Rgb Grey(float value) { return {value, value, value}; }

Rgb operator*(Rgb color, float factor) {
  for (float& value : color) value *= factor;
  return color;
}

// Means of a stream and of its halves, and the variance of the mean.
class Moments {
 public:
  void Add(float value, size_t half) {
    sum_[half] += double{value};
    square_ += double{value} * double{value};
    ++count_[half];
  }
  float half_mean(size_t half) const {
    return count_[half] == 0 ? 0.0f : static_cast<float>(sum_[half] / count_[half]);
  }
  float mean() const { return static_cast<float>((sum_[0] + sum_[1]) / n()); }
  float variance_of_mean() const {
    const double total = sum_[0] + sum_[1];
    return static_cast<float>(std::max(0.0, square_ - total * total / n()) / (n() * (n() - 1)));
  }

 private:
  double n() const { return count_[0] + count_[1]; }
  std::array<double, 2> sum_{}, count_{};
  double square_ = 0;
};

using Sampler = std::function<Sample(int x, int y, std::mt19937& random)>;
using Truth = std::function<Rgb(int x, int y)>;
using Counter = std::function<uint32_t(int x, int y)>;

void DrawPixel(const Sampler& sampler, int x, int y, uint32_t count, std::mt19937& random,
               FramePlanes* planes) {
  const auto p = static_cast<size_t>(planes->bounds.IndexOf(x, y));
  std::array<Moments, 3> color, albedo, normal;
  Moments depth;
  for (uint32_t i = 0; i < count; ++i) {
    const Sample sample = sampler(x, y, random);
    for (size_t c = 0; c < 3; ++c) {
      color[c].Add(sample.color[c], i & 1);
      albedo[c].Add(sample.albedo[c], i & 1);
      normal[c].Add(sample.normal[c], i & 1);
    }
    depth.Add(sample.depth, i & 1);
  }
  planes->samples[p] = count;
  planes->coverage[p] = 1;
  planes->material_id[p] = 1;
  for (size_t c = 0; c < 3; ++c) {
    planes->color[c][p] = color[c].mean();
    planes->color_half[0][c][p] = color[c].half_mean(0);
    planes->color_half[1][c][p] = color[c].half_mean(1);
    planes->sample_variance_of_mean[c][p] = color[c].variance_of_mean();
    planes->albedo[c][p] = albedo[c].mean();
    planes->albedo_variance[c][p] = albedo[c].variance_of_mean();
    planes->normal[c][p] = normal[c].mean();
    planes->normal_variance[c][p] = normal[c].variance_of_mean();
  }
  planes->depth[p] = depth.mean();
  planes->depth_variance[p] = depth.variance_of_mean();
}

SyntheticFrame Draw(int side, uint32_t seed, const Counter& counter, const Truth& truth,
                    const Sampler& sampler) {
  const PixelRect bounds{0, 0, side, side};
  SyntheticFrame frame{FramePlanes(bounds), {}};
  for (Plane& plane : frame.truth) plane.resize(static_cast<size_t>(bounds.area()));
  std::mt19937 random(seed);
  for (int y = 0; y < side; ++y) {
    for (int x = 0; x < side; ++x) {
      DrawPixel(sampler, x, y, counter(x, y), random, &frame.planes);
      const Rgb value = truth(x, y);
      for (size_t c = 0; c < 3; ++c) {
        frame.truth[c][static_cast<size_t>(bounds.IndexOf(x, y))] = value[c];
      }
    }
  }
  CalibrateVariance(bounds, &frame.planes);
  return frame;
}

// `count` samples everywhere, each the truth times noise of mean 1.
SyntheticFrame DrawLit(int side, uint32_t seed, uint32_t count, const Truth& truth, float noise,
                       const std::function<void(int x, int y, Sample* sample)>& add_features) {
  return Draw(side, seed, [=](int, int) { return count; }, truth,
              [&](int x, int y, std::mt19937& random) {
                // Squares of normal numbers have mean 1 and a standard deviation of sqrt(2).
                const float z = std::normal_distribution<float>()(random);
                Sample sample{truth(x, y) * (1 + noise * (z * z - 1) / std::sqrt(2.0f))};
                add_features(x, y, &sample);
                return sample;
              });
}

void NoFeatures(int, int, Sample*) {}

bool OnChecker(int x, int y, int side) { return (x / side + y / side) % 2 == 0; }

// Of the mean e^0 = 1.
float Lognormal(std::mt19937& random) {
  return std::exp(std::normal_distribution<float>(-0.5f, 1.0f)(random));
}

bool OnWire(int x, int y) { return (x + y / 3) % 9 == 0; }

float Penumbra(int x) { return std::clamp((static_cast<float>(x) - 14) / 16, 0.0f, 1.0f); }

Rgb ShadowedWall(int x, int y) {
  const float dx = static_cast<float>(x) - 42, dy = static_cast<float>(y) - 32;
  const float off_ring = std::sqrt(dx * dx + dy * dy) - 12;
  const float caustic = off_ring * off_ring < 2.25f ? 1.5f : 0.0f;
  return Rgb{0.6f, 0.5f, 0.4f} * (0.2f + 0.8f * Penumbra(x) + caustic);
}

// Of a hash of the place: finaliser of MurmurHash3 (Appleby 2011), shortened.
float TexelAt(int x, int y) {
  uint32_t h = static_cast<uint32_t>(x) * 73856093u ^ static_cast<uint32_t>(y) * 19349663u;
  h = (h ^ h >> 16) * 0x85ebca6bu;
  h = (h ^ h >> 13) * 0xc2b2ae35u;
  return 0.15f + 0.7f * static_cast<float>(h >> 24) / 255;
}

constexpr int kBlurPx = 4;  // of the defocused wall, to either side

constexpr FailureFrame kFrames[] = {
    {"fireflies", "One sample of 10,000 among samples of about 0.5.", FireflyFrame},
    {"rare_light", "4 samples a pixel, of which one in 20 finds the light.", RareLightFrame},
    {"lognormal", "Noise that is strongest where the mean is drawn high.", LognormalFrame},
    {"wires", "Wires one pixel wide, shown by features.", WireFrame},
    {"mirror", "A mirrored checkerboard that no feature shows.", MirrorFrame},
    {"shadows", "A penumbra and a caustic that no feature shows.", ShadowFrame},
    {"defocus", "A checkerboard out of focus: its albedo is as noisy as its colour.", DefocusFrame},
    {"texture", "A texture of single pixels in the albedo.", TextureFrame},
    {"smooth_wall", "A receding wall, 4 samples: blotches and bands would show.", SmoothWallFrame},
    {"adaptive", "Cells that got 8 or 32 samples by what their first 4 were.", AdaptiveFrame},
};

}  // namespace

std::span<const FailureFrame> FailureFrames() { return kFrames; }

SyntheticFrame QuietFrame(uint32_t seed) {
  return DrawLit(64, seed, 16, [](int, int) { return Grey(0.5f); }, 0.4f, NoFeatures);
}

SyntheticFrame FireflyFrame(uint32_t seed) {
  SyntheticFrame frame = QuietFrame(seed);
  FramePlanes& planes = frame.planes;
  const auto p = static_cast<size_t>(planes.bounds.IndexOf(kFireflyX, kFireflyY));
  for (size_t c = 0; c < 3; ++c) {
    // One of 16 samples, in half A: its square over 16 * 15 is nearly all of the variance.
    planes.color_half[0][c][p] += 1e4f / 8;
    planes.color[c][p] += 1e4f / 16;
    planes.sample_variance_of_mean[c][p] += 1e8f / 256;
  }
  CalibrateVariance(planes.bounds, &planes);
  return frame;
}

SyntheticFrame RareLightFrame(uint32_t seed) {
  return Draw(64, seed, [](int, int) { return 4u; }, [](int, int) { return Grey(0.5f); },
              [](int, int, std::mt19937& random) {
                return Sample{Grey(random() % 20 == 0 ? 10.0f : 0.0f)};
              });
}

SyntheticFrame LognormalFrame(uint32_t seed) {
  return Draw(128, seed, [](int, int) { return 16u; }, [](int, int) { return Grey(0.5f); },
              [](int, int, std::mt19937& random) {
                return Sample{Grey(0.5f * Lognormal(random))};
              });
}

SyntheticFrame WireFrame(uint32_t seed) {
  return DrawLit(64, seed, 8, [](int x, int y) { return Grey(OnWire(x, y) ? 0.8f : 0.1f); }, 0.6f,
                 [](int x, int y, Sample* sample) {
                   sample->albedo = Grey(OnWire(x, y) ? 0.8f : 0.3f);
                   sample->depth = OnWire(x, y) ? 2.0f : 4.0f;
                 });
}

SyntheticFrame MirrorFrame(uint32_t seed) {
  return DrawLit(64, seed, 16,
                 [](int x, int y) {
                   return OnChecker(x, y, 5) ? Rgb{0.8f, 0.6f, 0.4f} : Rgb{0.1f, 0.2f, 0.3f};
                 },
                 0.5f, NoFeatures);
}

SyntheticFrame ShadowFrame(uint32_t seed) {
  return DrawLit(64, seed, 16, ShadowedWall, 0.5f, NoFeatures);
}

SyntheticFrame DefocusFrame(uint32_t seed) {
  const auto albedo = [](int x, int y) { return Grey(OnChecker(x + 64, y + 64, 9) ? 0.9f : 0.1f); };
  const auto truth = [albedo](int x, int y) {
    float sum = 0;
    for (int dy = -kBlurPx; dy <= kBlurPx; ++dy) {
      for (int dx = -kBlurPx; dx <= kBlurPx; ++dx) sum += albedo(x + dx, y + dy)[0];
    }
    return Grey(sum / ((2 * kBlurPx + 1) * (2 * kBlurPx + 1)));
  };
  return Draw(64, seed, [](int, int) { return 16u; }, truth,
              [albedo](int x, int y, std::mt19937& random) {
                constexpr uint32_t kPlaces = 2 * kBlurPx + 1;
                const int dx = static_cast<int>(random() % kPlaces) - kBlurPx;
                const int dy = static_cast<int>(random() % kPlaces) - kBlurPx;
                const float z = std::normal_distribution<float>()(random);
                return Sample{albedo(x + dx, y + dy) * (1 + 0.3f * z), albedo(x + dx, y + dy)};
              });
}

SyntheticFrame TextureFrame(uint32_t seed) {
  return DrawLit(64, seed, 8, [](int x, int y) { return Grey(0.8f * TexelAt(x, y)); }, 0.8f,
                 [](int x, int y, Sample* sample) { sample->albedo = Grey(TexelAt(x, y)); });
}

SyntheticFrame SmoothWallFrame(uint32_t seed) {
  return DrawLit(128, seed, 4,
                 [](int x, int y) {
                   return Rgb{0.7f, 0.6f, 0.5f} * (0.4f + 0.004f * static_cast<float>(x + y));
                 },
                 0.8f, [](int x, int, Sample* sample) {
                   sample->depth = 2.0f + 0.05f * static_cast<float>(x);
                 });
}

SyntheticFrame LampFrame(uint32_t seed, uint32_t samples) {
  constexpr float kWall = 0.1f, kLamp = 200;
  const auto is_lit = [](int x, int y) { return x == kLampX && y == kLampY; };
  return Draw(64, seed, [samples](int, int) { return samples; },
              [&](int x, int y) { return Grey(is_lit(x, y) ? (kWall + kLamp) / 2 : kWall); },
              [&](int x, int y, std::mt19937& random) {
                Sample sample;
                const float noise = std::normal_distribution<float>(1, 0.2f)(random);
                sample.color = Grey(kWall * noise);
                if (is_lit(x, y) && random() % 2 == 0) {
                  sample.color = Grey(kLamp);
                  sample.albedo = Grey(0);
                }
                return sample;
              });
}

SyntheticFrame AdaptiveFrame(uint32_t seed) {
  constexpr int kSide = 128, kCell = 16, kCells = kSide / kCell;
  // The first four samples of every pixel are drawn ahead and drawn again, the same, for the frame.
  const auto first_four = [seed](int x, int y) {
    std::mt19937 random(seed * 1000003u + static_cast<uint32_t>(y * kSide + x));
    std::array<float, 4> samples;
    for (float& sample : samples) sample = 0.5f * Lognormal(random);
    return samples;
  };
  std::array<double, kCells * kCells> spread{};
  double mean_spread = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      for (const float s : first_four(x, y)) {
        const double square = (s - 0.5) * (s - 0.5);
        spread[static_cast<size_t>(y / kCell * kCells + x / kCell)] += square;
        mean_spread += square / (kCells * kCells);
      }
    }
  }
  int drawn = 0, last = -1;
  return Draw(kSide, seed,
              [&](int x, int y) {
                const double here = spread[static_cast<size_t>(y / kCell * kCells + x / kCell)];
                return here > mean_spread ? 32u : 8u;
              },
              [](int, int) { return Grey(0.5f); },
              [&](int x, int y, std::mt19937& random) {
                drawn = y * kSide + x == last ? drawn + 1 : 0;
                last = y * kSide + x;
                const float value = drawn < 4 ? first_four(x, y)[static_cast<size_t>(drawn)]
                                              : 0.5f * Lognormal(random);
                return Sample{Grey(value)};
              });
}

}  // namespace tessera
