#include "core/image/compare.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"

namespace tessera {
namespace {

constexpr double kRelativeFloor = 0.01;
constexpr double kTrimmedShare = 0.001;
constexpr std::array<double, 3> kLuma = {0.2126, 0.7152, 0.0722};  // ITU-R BT.709

using Channels = std::array<const std::vector<float>*, 3>;

absl::StatusOr<Channels> ColorChannels(const NamedImage& named) {
  const absl::string_view name(named.name.data(), named.name.size());
  Channels channels;
  for (int c = 0; c < 3; ++c) {
    const char* channel_name[] = {"R", "G", "B"};
    const ImageChannel* channel = named.image->Find(channel_name[c]);
    if (channel == nullptr || channel->is_uint) {
      return absl::InvalidArgumentError(absl::StrCat(name, ": no colour channel ", channel_name[c],
                                                     "; compare pictures with R, G and B"));
    }
    if (!std::ranges::all_of(channel->floats, [](float value) { return std::isfinite(value); })) {
      return absl::InvalidArgumentError(
          absl::StrCat(name, ": channel ", channel_name[c],
                       " holds values that are not finite; render or export it again"));
    }
    channels[c] = &channel->floats;
  }
  return channels;
}

absl::Status CheckSize(const NamedImage& a, const NamedImage& b) {
  if (a.image->width() == b.image->width() && a.image->height() == b.image->height()) {
    return absl::OkStatus();
  }
  return absl::InvalidArgumentError(absl::StrCat(
      absl::string_view(a.name.data(), a.name.size()), " has ", a.image->width(), "x",
      a.image->height(), " pixels, ", absl::string_view(b.name.data(), b.name.size()), " has ",
      b.image->width(), "x", b.image->height(), "; compare pictures of one size"));
}

// Each pixel's relative squared error, averaged over the channels.
std::vector<double> RelativeErrors(const Channels& test, const Channels& reference,
                                   const Channels& reference_2) {
  std::vector<double> errors(test[0]->size());
  for (int c = 0; c < 3; ++c) {
    for (size_t i = 0; i < errors.size(); ++i) {
      const double x = (*test[c])[i];
      const double r1 = (*reference[c])[i];
      const double r2 = (*reference_2[c])[i];
      const double mean = (r1 + r2) / 2;
      errors[i] += (x - r1) * (x - r2) / (mean * mean + kRelativeFloor) / 3;
    }
  }
  return errors;
}

double Mean(std::span<const double> values) {
  return std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
}

double TrimmedMean(std::vector<double> values) {
  const double share = kTrimmedShare * static_cast<double>(values.size());
  const size_t num_trimmed =
      std::min(static_cast<size_t>(std::max(std::lround(share), 1L)), values.size() - 1);
  const size_t num_kept = values.size() - num_trimmed;
  std::ranges::nth_element(values, values.begin() + static_cast<std::ptrdiff_t>(num_kept));
  return Mean(std::span(values).first(num_kept));
}

DisplayPicture Display(const Channels& a, const Channels& b, int width, int height,
                       const DisplayTransform& display) {
  const float exposure = std::exp2(display.exposure_ev);
  DisplayPicture picture;
  for (int c = 0; c < 3; ++c) {
    picture[c] = DoublePlane(width, height);
    for (size_t i = 0; i < a[c]->size(); ++i) {
      const float mean = 0.5f * (*a[c])[i] + 0.5f * (*b[c])[i];
      picture[c].values[i] = SrgbEncode(mean * exposure);
    }
  }
  return picture;
}

double Psnr(const DisplayPicture& a, const DisplayPicture& b) {
  double sum = 0;
  for (int c = 0; c < 3; ++c) {
    for (size_t i = 0; i < a[c].values.size(); ++i) {
      const double difference = a[c].values[i] - b[c].values[i];
      sum += difference * difference;
    }
  }
  const double mean = sum / (3 * static_cast<double>(a[0].values.size()));
  return mean > 0 ? -10 * std::log10(mean) : std::numeric_limits<double>::infinity();
}

DoublePlane Luma(const DisplayPicture& picture) {
  DoublePlane luma(picture[0].width, picture[0].height);
  for (int c = 0; c < 3; ++c) {
    for (size_t i = 0; i < luma.values.size(); ++i) {
      luma.values[i] += kLuma[c] * picture[c].values[i];
    }
  }
  return luma;
}

DoublePlane Product(const DoublePlane& a, const DoublePlane& b) {
  DoublePlane product(a.width, a.height);
  for (size_t i = 0; i < product.values.size(); ++i) {
    product.values[i] = a.values[i] * b.values[i];
  }
  return product;
}

}  // namespace

double MeanSsim(const DoublePlane& a, const DoublePlane& b) {
  constexpr double kC1 = 0.01 * 0.01;
  constexpr double kC2 = 0.03 * 0.03;
  std::array<double, 11> kernel;
  for (int i = 0; i < 11; ++i) kernel[i] = std::exp(-(i - 5) * (i - 5) / (2 * 1.5 * 1.5));
  const double kernel_sum = std::accumulate(kernel.begin(), kernel.end(), 0.0);
  for (double& weight : kernel) weight /= kernel_sum;
  const auto smooth = [&](const DoublePlane& p) { return FilterSeparable(p, kernel, kernel); };
  const DoublePlane mean_a = smooth(a), mean_b = smooth(b);
  const DoublePlane square_a = smooth(Product(a, a)), square_b = smooth(Product(b, b));
  const DoublePlane product = smooth(Product(a, b));
  double sum = 0;
  for (size_t i = 0; i < mean_a.values.size(); ++i) {
    const double ma = mean_a.values[i], mb = mean_b.values[i];
    const double va = square_a.values[i] - ma * ma;
    const double vb = square_b.values[i] - mb * mb;
    const double covariance = product.values[i] - ma * mb;
    sum += (2 * ma * mb + kC1) * (2 * covariance + kC2) /
           ((ma * ma + mb * mb + kC1) * (va + vb + kC2));
  }
  return sum / static_cast<double>(mean_a.values.size());
}

absl::StatusOr<ImageErrors> CompareImages(const NamedImage& test, const NamedImage& reference,
                                          const NamedImage& reference_2,
                                          const DisplayTransform& display) {
  const NamedImage& second = reference_2.image != nullptr ? reference_2 : reference;
  for (const NamedImage* other : {&reference, &second}) {
    const absl::Status status = CheckSize(test, *other);
    if (!status.ok()) return status;
  }
  const absl::StatusOr<Channels> x = ColorChannels(test);
  const absl::StatusOr<Channels> r1 = ColorChannels(reference);
  const absl::StatusOr<Channels> r2 = ColorChannels(second);
  for (const auto* channels : {&x, &r1, &r2}) {
    if (!channels->ok()) return channels->status();
  }
  const int width = test.image->width(), height = test.image->height();
  if (width <= 0 || height <= 0) return absl::InvalidArgumentError("the pictures are empty");
  const std::vector<double> errors = RelativeErrors(*x, *r1, *r2);
  const DisplayPicture shown = Display(*x, *x, width, height, display);
  const DisplayPicture shown_reference = Display(*r1, *r2, width, height, display);
  ImageErrors result;
  result.rel_mse = Mean(errors);
  result.rel_mse_trimmed = TrimmedMean(errors);
  result.psnr_db = Psnr(shown, shown_reference);
  result.ssim = MeanSsim(Luma(shown), Luma(shown_reference));
  result.flip = MeanFlip(shown, shown_reference);
  return result;
}

}  // namespace tessera
