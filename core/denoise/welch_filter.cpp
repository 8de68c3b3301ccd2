#include "core/denoise/welch_filter.h"

#include <algorithm>

#include "core/denoise/falloff.h"
#include "core/denoise/judged_picture.h"

namespace tessera {
namespace {

constexpr int kRadiusPreviewPx = 9;
// Larger values and variances are cut here: squares and their sums stay finite.
constexpr float kValueMax = 0x1p55f;
constexpr float kVarianceMax = 0x1p90f;
// The rounding error of a difference of two means, relative to their squares.
constexpr float kRoundingVariance = 0x1p-40f;
constexpr float kTiny = 1e-30f;

int RadiusOf(DenoiseQuality quality) {
  return quality == DenoiseQuality::kFinal ? kWelchRadiusPx : kRadiusPreviewPx;
}

// False for NaN.
float Cut(float value, float limit) { return value < limit ? value : limit; }

// What the filter reads, finite everywhere and continued past the frame's border by the nearest
// pixel; row-major over `bounds`.
struct Input {
  Input(const PixelRect& rect, const PixelRect& frame, const FramePlanes& planes) : bounds(rect) {
    const auto area = static_cast<size_t>(bounds.area());
    for (Planes3* three : {&color, &variance, &calibrated, &albedo, &normal}) {
      for (Plane& plane : *three) plane.resize(area);
    }
    reciprocal_freedom.resize(area);
    known.resize(area);
    size_t to = 0;
    for (int y = bounds.y_begin; y < bounds.y_end; ++y) {
      const int from_y = std::clamp(y, frame.y_begin, frame.y_end - 1);
      for (int x = bounds.x_begin; x < bounds.x_end; ++x, ++to) {
        const int from_x = std::clamp(x, frame.x_begin, frame.x_end - 1);
        const auto from = static_cast<size_t>(planes.bounds.IndexOf(from_x, from_y));
        const uint32_t count = planes.samples[from];
        known[to] = count >= 2 && frame.Contains(x, y) ? 1.0f : 0.0f;
        reciprocal_freedom[to] = count >= 2 ? 1.0f / static_cast<float>(count - 1) : 1.0f;
        for (size_t c = 0; c < 3; ++c) {
          color[c][to] = Cut(planes.color[c][from], kValueMax);
          const float rounding = kRoundingVariance * color[c][to] * color[c][to];
          variance[c][to] = Cut(planes.sample_variance_of_mean[c][from], kVarianceMax) + rounding;
          calibrated[c][to] = Cut(planes.variance[c][from], kVarianceMax) + rounding;
          albedo[c][to] = planes.albedo[c][from];
          normal[c][to] = planes.normal[c][from];
        }
      }
    }
  }

  PixelRect bounds;
  Planes3 color;             // means of both halves
  Planes3 variance;          // of those means, by the samples' spread
  Planes3 calibrated;        // the same, by the halves
  Planes3 albedo, normal;
  Plane reciprocal_freedom;  // 1 / (samples - 1)
  Plane known;               // 1: inside the frame, two samples or more; else 0
};

// The inner loops, over `num_pixels` of a row: functions because GCC heeds __restrict in parameters
// alone. Pointers are to the pixels p; their neighbours q lie `shift` further.

inline float QuantileSquared(float u) {
  constexpr float z = kWelchNormalQuantile;
  constexpr float z2 = z * z;
  constexpr float g1 = z * (z2 + 1) / 4;
  constexpr float g2 = z * ((5 * z2 + 16) * z2 + 3) / 96;
  constexpr float g3 = z * (((3 * z2 + 19) * z2 + 17) * z2 - 15) / 384;
  constexpr float g4 = z * ((((79 * z2 + 776) * z2 + 1482) * z2 - 1920) * z2 - 945) / 92160;
  const float t = z + u * (g1 + u * (g2 + u * (g3 + u * g4)));
  return t * t;
}

// Makes `member` 0 where Welch's test tells p from q.
void TestChannel(size_t num_pixels, int64_t shift, const float* color, const float* variance,
                 const float* reciprocal_freedom, float* __restrict member) {
  const float* color_q = color + shift;
  const float* variance_q = variance + shift;
  const float* reciprocal_freedom_q = reciprocal_freedom + shift;
  for (size_t x = 0; x < num_pixels; ++x) {
    const float sum = variance[x] + variance_q[x];
    const float share = variance[x] / (sum + kTiny);
    const float share_q = variance_q[x] / (sum + kTiny);
    // 1 / the degrees of freedom, by Satterthwaite.
    const float u =
        share * share * reciprocal_freedom[x] + share_q * share_q * reciprocal_freedom_q[x];
    const float d = color[x] - color_q[x];
    member[x] = d * d <= QuantileSquared(u) * sum ? member[x] : 0.0f;
  }
}

// Adds the squared difference of a vector feature in units of 2 sigma^2.
void AddFeatureDistance(size_t num_pixels, int64_t shift, float scale, const float* x0,
                        const float* x1, const float* x2, float* __restrict distance) {
  for (size_t x = 0; x < num_pixels; ++x) {
    const float d0 = x0[x] - (x0 + shift)[x];
    const float d1 = x1[x] - (x1 + shift)[x];
    const float d2 = x2[x] - (x2 + shift)[x];
    distance[x] += (d0 * d0 + d1 * d1 + d2 * d2) * scale;
  }
}

// Turns membership into weights and adds them to their sum.
void SetWeights(size_t num_pixels, float spatial_weight, const float* distance,
                float* __restrict weight, float* __restrict weight_sum) {
  for (size_t x = 0; x < num_pixels; ++x) {
    weight[x] *= spatial_weight * Falloff(distance[x]);
    weight_sum[x] += weight[x];
  }
}

// Adds what the neighbours have more than the pixel: nothing to round where both are equal.
void AddWeighted(size_t num_pixels, int64_t shift, const float* weight, const float* color,
                 const float* variance, float* __restrict sum, float* __restrict variance_sum) {
  const float* color_q = color + shift;
  const float* variance_q = variance + shift;
  for (size_t x = 0; x < num_pixels; ++x) {
    sum[x] += weight[x] * (color_q[x] - color[x]);
    variance_sum[x] += weight[x] * weight[x] * variance_q[x];
  }
}

// Filters one row of `out`, which is zero there.
class RowFilter {
 public:
  RowFilter(const FramePlanes& planes, const Input& input, int radius, JudgedPicture* out)
      : planes_(planes),
        in_(input),
        radius_(radius),
        out_(*out),
        width_(static_cast<size_t>(out->bounds.width())),
        distance_(width_),
        weight_(width_),
        weight_sum_(width_) {}

  void Filter(int y) {
    std::ranges::fill(weight_sum_, 0.0f);
    for (int dy = -radius_; dy <= radius_; ++dy) {
      for (int dx = -radius_; dx <= radius_; ++dx) AddNeighbours(y, dx, dy);
    }
    for (size_t x = 0; x < width_; ++x) Finish(x, y);
  }

 private:
  void AddNeighbours(int y, int dx, int dy) {
    const int64_t shift = int64_t{dy} * in_.bounds.width() + dx;
    const auto p = static_cast<size_t>(in_.bounds.IndexOf(out_.bounds.x_begin, y));
    const auto to = static_cast<size_t>(out_.bounds.IndexOf(out_.bounds.x_begin, y));
    std::copy_n(&in_.known[p + static_cast<size_t>(shift)], width_, weight_.begin());
    std::ranges::fill(distance_, 0.0f);
    for (size_t c = 0; c < 3; ++c) {
      TestChannel(width_, shift, &in_.color[c][p], &in_.variance[c][p], &in_.reciprocal_freedom[p],
                  weight_.data());
    }
    AddFeatureDistance(width_, shift, 0.5f / (kWelchSigmaAlbedo * kWelchSigmaAlbedo),
                       &in_.albedo[0][p], &in_.albedo[1][p], &in_.albedo[2][p], distance_.data());
    AddFeatureDistance(width_, shift, 0.5f / (kWelchSigmaNormal * kWelchSigmaNormal),
                       &in_.normal[0][p], &in_.normal[1][p], &in_.normal[2][p], distance_.data());
    const float spatial =
        Falloff(static_cast<float>(dx * dx + dy * dy) * (0.5f / (kWelchSigmaPx * kWelchSigmaPx)));
    SetWeights(width_, spatial, distance_.data(), weight_.data(), weight_sum_.data());
    for (size_t c = 0; c < 3; ++c) {
      AddWeighted(width_, shift, weight_.data(), &in_.color[c][p], &in_.calibrated[c][p],
                  &out_.color[c][to], &out_.noise[c][to]);
    }
  }

  // A known pixel is its own neighbour with weight 1, so the sum is no less.
  void Finish(size_t x, int y) {
    const int frame_x = out_.bounds.x_begin + static_cast<int>(x);
    const auto i = static_cast<size_t>(out_.bounds.IndexOf(frame_x, y));
    const auto from = static_cast<size_t>(in_.bounds.IndexOf(frame_x, y));
    const auto p = static_cast<size_t>(planes_.bounds.IndexOf(frame_x, y));
    const bool is_known = planes_.samples[p] >= 2;
    out_.known[i] = is_known ? 1.0f : 0.0f;
    const float scale = is_known ? 1.0f / weight_sum_[x] : 0.0f;
    for (size_t c = 0; c < 3; ++c) {
      const float variance = in_.calibrated[c][from];
      const float residual = out_.color[c][i] * scale;
      out_.color[c][i] = in_.color[c][from] + residual;
      out_.noise[c][i] *= scale * scale;
      out_.risk[c][i] =
          is_known ? residual * residual - variance + 2.0f * scale * variance : 0.0f;
    }
  }

  const FramePlanes& planes_;
  const Input& in_;
  const int radius_;
  JudgedPicture& out_;
  const size_t width_;
  Plane distance_, weight_, weight_sum_;  // of one row
};

}  // namespace

float WelchQuantileSquared(float reciprocal_freedom) { return QuantileSquared(reciprocal_freedom); }

int WelchFilter::halo_px(DenoiseQuality quality) const {
  return RadiusOf(quality) + kPoolingRadiusPx;
}

void WelchFilter::Filter(const FramePlanes& planes, const FrameParameters& parameters,
                         const PixelRect& window, FilteredPlanes* out) const {
  const int radius = RadiusOf(parameters.quality);
  JudgedPicture picture(window.Expand(kPoolingRadiusPx).Intersect(parameters.frame));
  const Input input(picture.bounds.Expand(radius), parameters.frame, planes);
  RowFilter filter(planes, input, radius, &picture);
  for (int y = picture.bounds.y_begin; y < picture.bounds.y_end; ++y) filter.Filter(y);
  WriteJudged(planes, picture, window, WhereRawIsBetter::kKeepFiltered, out);
}

}  // namespace tessera
