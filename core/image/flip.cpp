#include "core/image/flip.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/image/display_transform.h"

namespace tessera {
namespace {

constexpr double kPi = 3.14159265358979323846;
// Section 4.1.3 of the paper: exponents and the two ends of the colour error's linear pieces.
constexpr double kColorExponent = 0.7;
constexpr double kColorKnee = 0.4;
constexpr double kColorKneeError = 0.95;
// Section 4.2: the width of an edge that the eye sees best, in degrees, and the exponent.
constexpr double kFeatureWidthDegrees = 0.082;
constexpr double kFeatureExponent = 0.5;

using Triple = std::array<double, 3>;
using Matrix = std::array<Triple, 3>;
using Planes = std::array<DoublePlane, 3>;

Triple Multiply(const Matrix& m, const Triple& v) {
  Triple result;
  for (int i = 0; i < 3; ++i) result[i] = m[i][0] * v[0] + m[i][1] * v[1] + m[i][2] * v[2];
  return result;
}

Matrix Invert(const Matrix& m) {
  Matrix inverse;
  double determinant = 0;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      const int i1 = (i + 1) % 3, i2 = (i + 2) % 3, j1 = (j + 1) % 3, j2 = (j + 2) % 3;
      inverse[j][i] = m[i1][j1] * m[i2][j2] - m[i1][j2] * m[i2][j1];
    }
    determinant += m[0][i] * inverse[i][0];
  }
  for (Triple& row : inverse) {
    for (double& value : row) value /= determinant;
  }
  return inverse;
}

// Linear sRGB to XYZ and back, from the primaries and the white point of IEC 61966-2-1.
struct ColorSpace {
  Matrix to_xyz;
  Matrix from_xyz;
  Triple white;

  ColorSpace() {
    const auto xyz_of = [](double x, double y) { return Triple{x / y, 1.0, (1 - x - y) / y}; };
    const Triple red = xyz_of(0.64, 0.33), green = xyz_of(0.30, 0.60), blue = xyz_of(0.15, 0.06);
    white = xyz_of(0.3127, 0.3290);
    Matrix primaries;
    for (int i = 0; i < 3; ++i) primaries[i] = {red[i], green[i], blue[i]};
    const Triple intensity = Multiply(Invert(primaries), white);
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) to_xyz[i][j] = primaries[i][j] * intensity[j];
    }
    from_xyz = Invert(to_xyz);
  }
};

const ColorSpace& Srgb() {
  static const ColorSpace kSpace;
  return kSpace;
}

// XYZ over the white point's.
Triple RelativeXyz(const Triple& linear) {
  Triple xyz = Multiply(Srgb().to_xyz, linear);
  for (int i = 0; i < 3; ++i) xyz[i] /= Srgb().white[i];
  return xyz;
}

// The opponent space in which contrast sensitivity is given.
Triple ToYCxCz(const Triple& linear) {
  const Triple xyz = RelativeXyz(linear);
  return {116 * xyz[1] - 16, 500 * (xyz[0] - xyz[1]), 200 * (xyz[1] - xyz[2])};
}

Triple FromYCxCz(const Triple& color) {
  const double y = (color[0] + 16) / 116;
  Triple xyz = {y + color[1] / 500, y, y - color[2] / 200};
  for (int i = 0; i < 3; ++i) xyz[i] *= Srgb().white[i];
  return Multiply(Srgb().from_xyz, xyz);
}

// CIELAB with Hunt's adjustment: colours of dark pixels matter less.
Triple ToHuntLab(const Triple& linear) {
  constexpr double kDelta = 6.0 / 29.0;
  Triple f = RelativeXyz(linear);
  for (double& value : f) {
    value = value > kDelta * kDelta * kDelta ? std::cbrt(value)
                                             : value / (3 * kDelta * kDelta) + 4.0 / 29.0;
  }
  const double lightness = 116 * f[1] - 16;
  return {lightness, 0.01 * lightness * 500 * (f[0] - f[1]),
          0.01 * lightness * 200 * (f[1] - f[2])};
}

double HyAb(const Triple& a, const Triple& b) {
  return std::abs(a[0] - b[0]) + std::hypot(a[1] - b[1], a[2] - b[2]);
}

Planes OpponentPlanes(const DisplayPicture& picture) {
  const int width = picture[0].width, height = picture[0].height;
  Planes planes = {DoublePlane(width, height), DoublePlane(width, height),
                   DoublePlane(width, height)};
  for (size_t i = 0; i < picture[0].values.size(); ++i) {
    Triple linear;
    for (int c = 0; c < 3; ++c) {
      linear[c] = SrgbDecode(static_cast<float>(picture[c].values[i]));
    }
    const Triple color = ToYCxCz(linear);
    for (int c = 0; c < 3; ++c) planes[c].values[i] = color[c];
  }
  return planes;
}

// One Gaussian of a contrast sensitivity function: a sqrt(pi / b) exp(-pi^2 d^2 / b), d in degrees.
struct SensitivityTerm {
  double a;
  double b;
};

DoublePlane FilterBySensitivity(const DoublePlane& plane, std::span<const SensitivityTerm> terms,
                                double pixels_per_degree) {
  const int radius =
      static_cast<int>(std::ceil(3 * std::sqrt(0.04 / (2 * kPi * kPi)) * pixels_per_degree));
  DoublePlane sum(plane.width, plane.height);
  double weight_sum = 0;
  for (const SensitivityTerm& term : terms) {
    std::vector<double> kernel;
    for (int i = -radius; i <= radius; ++i) {
      const double degrees = i / pixels_per_degree;
      kernel.push_back(std::exp(-kPi * kPi * degrees * degrees / term.b));
    }
    const double scale = term.a * std::sqrt(kPi / term.b);
    const double kernel_sum = std::accumulate(kernel.begin(), kernel.end(), 0.0);
    weight_sum += scale * kernel_sum * kernel_sum;
    const DoublePlane filtered = FilterSeparable(plane, kernel, kernel);
    for (size_t i = 0; i < sum.values.size(); ++i) sum.values[i] += scale * filtered.values[i];
  }
  for (double& value : sum.values) value /= weight_sum;
  return sum;
}

// What the eye resolves of the colours.
Planes PerceivedColors(const Planes& opponent, double pixels_per_degree) {
  constexpr SensitivityTerm kAchromatic[] = {{1, 0.0047}};
  constexpr SensitivityTerm kRedGreen[] = {{1, 0.0053}};
  constexpr SensitivityTerm kBlueYellow[] = {{34.1, 0.04}, {13.5, 0.025}};
  Planes seen = {FilterBySensitivity(opponent[0], kAchromatic, pixels_per_degree),
                 FilterBySensitivity(opponent[1], kRedGreen, pixels_per_degree),
                 FilterBySensitivity(opponent[2], kBlueYellow, pixels_per_degree)};
  for (size_t i = 0; i < seen[0].values.size(); ++i) {
    Triple linear = FromYCxCz({seen[0].values[i], seen[1].values[i], seen[2].values[i]});
    for (double& value : linear) value = std::clamp(value, 0.0, 1.0);
    const Triple lab = ToHuntLab(linear);
    for (int c = 0; c < 3; ++c) seen[c].values[i] = lab[c];
  }
  return seen;
}

// Maps the colour distance to [0, 1], small errors over most of it.
double ColorError(double hyab) {
  static const double kMax =
      std::pow(HyAb(ToHuntLab({0, 1, 0}), ToHuntLab({0, 0, 1})), kColorExponent);
  const double error = std::pow(hyab, kColorExponent);
  const double knee = kColorKnee * kMax;
  if (error < knee) return error / knee * kColorKneeError;
  return kColorKneeError + (error - knee) / (kMax - knee) * (1 - kColorKneeError);
}

// Strength of edges (first derivative) or points (second) in the achromatic plane.
DoublePlane FeatureStrength(const DoublePlane& plane, bool points, double pixels_per_degree) {
  const double sigma = 0.5 * kFeatureWidthDegrees * pixels_per_degree;
  const int radius = static_cast<int>(std::ceil(3 * sigma));
  std::vector<double> smooth, derivative;
  for (int i = -radius; i <= radius; ++i) {
    const double gaussian = std::exp(-i * i / (2 * sigma * sigma));
    smooth.push_back(gaussian);
    derivative.push_back((points ? i * i / (sigma * sigma) - 1 : -i) * gaussian);
  }
  const double smooth_sum = std::accumulate(smooth.begin(), smooth.end(), 0.0);
  for (double& value : smooth) value /= smooth_sum;
  // Positive weights sum to 1, negative ones to -1.
  double positive = 0, negative = 0;
  for (const double value : derivative) (value > 0 ? positive : negative) += std::abs(value);
  for (double& value : derivative) value /= value > 0 ? positive : negative;
  const DoublePlane along_x = FilterSeparable(plane, derivative, smooth);
  const DoublePlane along_y = FilterSeparable(plane, smooth, derivative);
  DoublePlane strength(plane.width, plane.height);
  for (size_t i = 0; i < strength.values.size(); ++i) {
    strength.values[i] = std::hypot(along_x.values[i], along_y.values[i]);
  }
  return strength;
}

}  // namespace

double MeanFlip(const DisplayPicture& test, const DisplayPicture& reference,
                double pixels_per_degree) {
  std::array<Planes, 2> opponent = {OpponentPlanes(test), OpponentPlanes(reference)};
  std::array<Planes, 2> colors;
  std::array<DoublePlane, 2> edges, points;
  for (int i = 0; i < 2; ++i) {
    colors[i] = PerceivedColors(opponent[i], pixels_per_degree);
    DoublePlane& achromatic = opponent[i][0];
    for (double& value : achromatic.values) value = (value + 16) / 116;
    edges[i] = FeatureStrength(achromatic, false, pixels_per_degree);
    points[i] = FeatureStrength(achromatic, true, pixels_per_degree);
  }
  double sum = 0;
  const size_t num_pixels = edges[0].values.size();
  for (size_t i = 0; i < num_pixels; ++i) {
    Triple lab[2];
    for (int k = 0; k < 2; ++k) {
      for (int c = 0; c < 3; ++c) lab[k][c] = colors[k][c].values[i];
    }
    const double feature = std::max(std::abs(edges[0].values[i] - edges[1].values[i]),
                                    std::abs(points[0].values[i] - points[1].values[i]));
    const double feature_error = std::pow(feature / std::sqrt(2.0), kFeatureExponent);
    sum += std::pow(ColorError(HyAb(lab[0], lab[1])), 1 - feature_error);
  }
  return sum / static_cast<double>(num_pixels);
}

}  // namespace tessera
