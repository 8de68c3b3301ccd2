#include "client/cli/half_images.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "client/cli/parse_values.h"
#include "core/denoise/box_sum.h"
#include "core/denoise/confidence.h"
#include "core/image/image_reader.h"

namespace tessera {
namespace {

constexpr int64_t kSppMax = int64_t{1} << 31;
// Where nothing but two halves tells their noise, its estimate joins (2 r + 1)^2 pixels: one
// difference alone is often near zero by chance, and a pixel so sure of itself keeps its noise.
constexpr int kDifferencePoolRadiusPx = 1;

using Names = std::vector<std::string>;

struct NamedImage {
  std::string path;
  Image image;
};

absl::StatusOr<NamedImage> Read(const std::string& path) {
  absl::StatusOr<Image> image = ReadImage(path);
  if (!image.ok()) return image.status();
  return NamedImage{path, *std::move(image)};
}

const ImageChannel* FindFloats(const Image& image, const std::string& name) {
  const ImageChannel* channel = image.Find(name);
  return channel != nullptr && !channel->is_uint ? channel : nullptr;
}

// The first of `choices` of which the image has every channel; empty if none.
Names FindNames(const Image& image, const std::vector<Names>& choices) {
  for (const Names& names : choices) {
    if (std::ranges::all_of(names, [&](const std::string& name) {
          return FindFloats(image, name) != nullptr;
        })) {
      return names;
    }
  }
  return {};
}

// `ends` behind the name of the only layer that has them, as multi-layer files of other renderers
// have ("ViewLayer.Combined.R"); empty if there is no such layer, or more than one.
Names OnlyLayer(const Image& image, const Names& ends) {
  Names found;
  for (const ImageChannel& channel : image.channels) {
    const std::string first = absl::StrCat(".", ends.front());
    if (!absl::EndsWith(channel.name, first)) continue;
    if (!found.empty()) return {};
    const std::string layer = channel.name.substr(0, channel.name.size() - ends.front().size());
    for (const std::string& end : ends) found.push_back(layer + end);
  }
  return FindNames(image, {found});
}

std::string ChannelList(const Image& image) {
  constexpr size_t kListedMax = 12;
  Names names;
  for (const ImageChannel& channel : image.channels) names.push_back(channel.name);
  const bool is_long = names.size() > kListedMax;
  if (is_long) names.resize(kListedMax);
  return absl::StrCat(absl::StrJoin(names, ", "), is_long ? ", ..." : "");
}

// What a kind of plane may be called, best first.
struct Kind {
  std::string name;             // as in flags and messages
  std::vector<Names> in_own;    // in a file of its own
  std::vector<Names> in_halves;  // beside the colour, in both halves; may be empty
};

const Kind kColor = {"colour", {{"raw.R", "raw.G", "raw.B"}, {"R", "G", "B"}}, {}};
const Kind kVariance = {"variance",
                        {{"R", "G", "B"}, {"variance.R", "variance.G", "variance.B"}},
                        {{"variance.R", "variance.G", "variance.B"}}};
const Kind kAlbedo = {"albedo",
                      {{"albedo.R", "albedo.G", "albedo.B"}, {"R", "G", "B"}},
                      {{"albedo.R", "albedo.G", "albedo.B"}}};
const Kind kNormal = {"normal",
                      {{"normal.X", "normal.Y", "normal.Z"}, {"X", "Y", "Z"}, {"R", "G", "B"}},
                      {{"normal.X", "normal.Y", "normal.Z"}, {"normal.R", "normal.G", "normal.B"}}};
const Kind kDepth = {"depth", {{"Z"}, {"depth.Z"}, {"Y"}, {"R"}, {"V"}}, {{"Z"}, {"depth.Z"}}};

// The planes of one kind of one file, in the frame's order.
using PlaneSet = std::vector<Plane>;

// Takes `names` out of a file. Depth beyond every hit, +inf, becomes 0, "no hit"; a variance that
// is no number, as 0 / 0 samples make it, becomes +inf, "unknown".
absl::StatusOr<PlaneSet> Take(const NamedImage& from, const Names& names, const Kind& kind) {
  PlaneSet planes;
  for (const std::string& name : names) {
    Plane plane = FindFloats(from.image, name)->floats;
    const bool is_variance = kind.name == kVariance.name;
    if (kind.name == kDepth.name) std::ranges::replace(plane, kInfinity, 0.0f);
    for (float& value : plane) {
      if (is_variance && !std::isfinite(value)) value = kInfinity;
      if (!is_variance && !std::isfinite(value)) {
        return absl::InvalidArgumentError(
            absl::StrCat(from.path, ": channel ", name,
                         " has values that are no numbers: render it again, or replace them"));
      }
      if (is_variance && value < 0) {
        return absl::InvalidArgumentError(absl::StrCat(
            from.path, ": channel ", name, " has negative values: a variance is none; leave the "
            "flag out, and it is estimated from the halves"));
      }
    }
    planes.push_back(std::move(plane));
  }
  return planes;
}

// Reads a file of its own for one kind; `window` is what all files must cover.
absl::StatusOr<PlaneSet> ReadOwn(const std::string& path, const Kind& kind, const Kind& values,
                                 const NamedImage& half_a) {
  const absl::StatusOr<NamedImage> file = Read(path);
  if (!file.ok()) return file.status();
  if (file->image.data_window != half_a.image.data_window) {
    return absl::InvalidArgumentError(absl::StrCat(
        path, ": is ", file->image.width(), "x", file->image.height(), " pixels at other places "
        "than ", half_a.path, " (", half_a.image.width(), "x", half_a.image.height(),
        "): give files of one frame, cut alike"));
  }
  Names names = FindNames(file->image, kind.in_own);
  if (names.empty()) names = OnlyLayer(file->image, kind.in_own.back());
  if (names.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": has no ", kind.name, " that is known by its channels ",
                     absl::StrJoin(kind.in_own.back(), ", "), " (it has ",
                     ChannelList(file->image), "): write these alone"));
  }
  return Take(*file, names, values);
}

// Means of two halves and the variances of those means, which their difference tells.
struct Joined {
  PlaneSet mean, variance;
};
Joined Join(const PlaneSet& a, const PlaneSet& b) {
  Joined joined{a, a};
  for (size_t c = 0; c < a.size(); ++c) {
    for (size_t i = 0; i < a[c].size(); ++i) {
      const float difference = a[c][i] - b[c][i];
      joined.mean[c][i] = (a[c][i] + b[c][i]) / 2;
      joined.variance[c][i] = difference * difference / 4;
    }
  }
  return joined;
}

// Means over the pixels around.
PlaneSet Pool(PlaneSet planes, const PixelRect& bounds) {
  const Plane ones(static_cast<size_t>(bounds.area()), 1.0f);
  const Plane count = BoxSum(ones, bounds, kDifferencePoolRadiusPx, bounds);
  for (Plane& plane : planes) {
    plane = BoxSum(plane, bounds, kDifferencePoolRadiusPx, bounds);
    for (size_t i = 0; i < plane.size(); ++i) plane[i] /= count[i];
  }
  return planes;
}

// Replaces `variance` by `given`; but where that is unknown and `has_halves`, what the difference
// of the halves has put there stays.
void TakeKnown(PlaneSet given, bool has_halves, PlaneSet* variance) {
  for (size_t c = 0; c < given.size(); ++c) {
    for (size_t i = 0; i < given[c].size(); ++i) {
      if (has_halves && !(given[c][i] < kInfinity)) continue;
      (*variance)[c][i] = given[c][i];
    }
  }
}

class Reader {
 public:
  explicit Reader(const HalvesFlags& flags) : flags_(flags) {}

  absl::StatusOr<DenoiseInput> Run() {
    const absl::Status halves = ReadHalves();
    if (!halves.ok()) return halves;
    const absl::Status spp = ReadSpp();
    if (!spp.ok()) return spp;
    const absl::Status variance = ReadVariance();
    if (!variance.ok()) return variance;
    FramePlanes& planes = input_.planes;
    const absl::Status albedo =
        ReadFeature(kAlbedo, flags_.albedo, Planes(planes.albedo), Planes(planes.albedo_variance));
    if (!albedo.ok()) return albedo;
    const absl::Status normal =
        ReadFeature(kNormal, flags_.normal, Planes(planes.normal), Planes(planes.normal_variance));
    if (!normal.ok()) return normal;
    const absl::Status depth =
        ReadFeature(kDepth, flags_.depth, {&planes.depth}, {&planes.depth_variance});
    if (!depth.ok()) return depth;
    return std::move(input_);
  }

 private:
  using Targets = std::vector<Plane*>;
  static Targets Planes(Planes3& three) { return {&three[0], &three[1], &three[2]}; }
  static void Move(PlaneSet from, const Targets& to) {
    for (size_t c = 0; c < to.size(); ++c) *to[c] = std::move(from[c]);
  }
  template <typename... Parts>
  void Note(const Parts&... parts) {
    input_.notes.push_back(absl::StrCat(parts...));
  }

  absl::Status ReadHalves();
  absl::Status ReadSpp();
  absl::Status ReadVariance();
  absl::Status ReadFeature(const Kind& kind, const FeatureFlags& flags, const Targets& mean,
                           const Targets& variance);
  // The planes of one kind of both halves, if both have it.
  absl::StatusOr<std::optional<std::array<PlaneSet, 2>>> FindInHalves(const Kind& kind) const;
  void FillUnderflows(PlaneSet* variance);

  const HalvesFlags& flags_;
  std::array<NamedImage, 2> halves_;
  DenoiseInput input_;
  Joined color_;
};

absl::Status Reader::ReadHalves() {
  std::array<PlaneSet, 2> color;
  for (size_t half = 0; half < 2; ++half) {
    absl::StatusOr<NamedImage> image = Read(half == 0 ? flags_.half_a : flags_.half_b);
    if (!image.ok()) return image.status();
    halves_[half] = *std::move(image);
    absl::StatusOr<PlaneSet> planes =
        ReadOwn(halves_[half].path, kColor, kColor, halves_[0]);
    if (!planes.ok()) return planes.status();
    color[half] = *std::move(planes);
  }
  if (color[0] == color[1]) {
    return absl::InvalidArgumentError(
        absl::StrCat(halves_[1].path, ": is equal to ", halves_[0].path,
                     ": render the second half with another seed"));
  }
  input_.frame = halves_[0].image.display_window;
  input_.planes = FramePlanes(halves_[0].image.data_window);
  color_ = Join(color[0], color[1]);
  for (size_t half = 0; half < 2; ++half) {
    Move(std::move(color[half]), Planes(input_.planes.color_half[half]));
  }
  Move(color_.mean, Planes(input_.planes.color));
  std::ranges::fill(input_.planes.coverage, 1.0f);
  return absl::OkStatus();
}

absl::Status Reader::ReadSpp() {
  int64_t spp = 0;
  if (!flags_.spp.empty()) {
    const absl::StatusOr<int64_t> parsed = ParseInteger("--spp", flags_.spp, 2, kSppMax);
    if (!parsed.ok()) return parsed.status();
    spp = *parsed / 2 * 2;
  } else {
    for (const NamedImage& half : halves_) {
      const auto found = half.image.metadata.find("spp");
      const bool is_there = found != half.image.metadata.end();
      const double* value = is_there ? std::get_if<double>(&found->second) : nullptr;
      const bool is_usable = value != nullptr && *value >= 1 && *value < double{kSppMax} / 2;
      if (!is_usable) {
        spp = 0;
        break;
      }
      spp += static_cast<int64_t>(*value);
    }
  }
  if (spp == 0) {
    spp = 2;
    Note("samples: not known (--spp N, of both halves together); the intervals allow for the "
         "least, 2");
  }
  std::ranges::fill(input_.planes.samples, static_cast<uint32_t>(spp));
  return absl::OkStatus();
}

absl::StatusOr<std::optional<std::array<PlaneSet, 2>>> Reader::FindInHalves(
    const Kind& kind) const {
  std::array<PlaneSet, 2> found;
  for (size_t half = 0; half < 2; ++half) {
    const Names names = FindNames(halves_[half].image, kind.in_halves);
    if (names.empty()) return std::nullopt;
    absl::StatusOr<PlaneSet> planes = Take(halves_[half], names, kind);
    if (!planes.ok()) return planes.status();
    found[half] = *std::move(planes);
  }
  return found;
}

// Files of half floats lose small variances and large ones: where the variance is 0 though the
// halves differ, or not finite, their difference stands for it.
void Reader::FillUnderflows(PlaneSet* variance) {
  size_t num_filled = 0;
  for (size_t c = 0; c < variance->size(); ++c) {
    for (size_t i = 0; i < (*variance)[c].size(); ++i) {
      const float given = (*variance)[c][i];
      if (given < kInfinity && (given > 0 || !(color_.variance[c][i] > 0))) continue;
      (*variance)[c][i] = color_.variance[c][i];
      ++num_filled;
    }
  }
  if (num_filled > 0) {
    Note("variance: 0 or no number at ", num_filled, " values whose halves differ; estimated there "
         "from the halves");
  }
}

absl::Status Reader::ReadVariance() {
  PlaneSet variance;
  if (!flags_.variance.empty()) {
    absl::StatusOr<PlaneSet> read = ReadOwn(flags_.variance, kVariance, kVariance, halves_[0]);
    if (!read.ok()) return read.status();
    variance = *std::move(read);
    Note("variance: of the mean of both halves, from ", flags_.variance);
    FillUnderflows(&variance);
  } else {
    auto found = FindInHalves(kVariance);
    if (!found.ok()) return found.status();
    if (found->has_value()) {
      auto& [a, b] = **found;
      for (size_t c = 0; c < a.size(); ++c) {
        for (size_t i = 0; i < a[c].size(); ++i) a[c][i] = (a[c][i] + b[c][i]) / 4;
      }
      variance = std::move(a);
      Note("variance: from the layers variance.* of the halves");
      FillUnderflows(&variance);
    } else {
      variance = Pool(color_.variance, input_.planes.bounds);
      Note("variance: estimated from the difference of the halves over 3x3 pixels (--variance)");
    }
  }
  Move(std::move(variance), Planes(input_.planes.sample_variance_of_mean));
  return absl::OkStatus();
}

absl::Status Reader::ReadFeature(const Kind& kind, const FeatureFlags& flags, const Targets& mean,
                                 const Targets& variance) {
  const std::string flag = absl::StrCat("--", kind.name);
  if (flags.file.empty() && !(flags.file_b.empty() && flags.variance.empty())) {
    return absl::InvalidArgumentError(absl::StrCat(
        flag, flags.file_b.empty() ? "-variance " : "-b ",
        flags.file_b.empty() ? flags.variance : flags.file_b, ": give ", flag, " too"));
  }
  Joined joined;
  if (!flags.file.empty()) {
    absl::StatusOr<PlaneSet> a = ReadOwn(flags.file, kind, kind, halves_[0]);
    if (!a.ok()) return a.status();
    joined = Join(*a, *a);
    if (!flags.file_b.empty()) {
      const absl::StatusOr<PlaneSet> b = ReadOwn(flags.file_b, kind, kind, halves_[0]);
      if (!b.ok()) return b.status();
      joined = Join(*a, *b);
    }
    if (!flags.variance.empty()) {
      absl::StatusOr<PlaneSet> own = ReadOwn(flags.variance, kind, kVariance, halves_[0]);
      if (!own.ok()) return own.status();
      TakeKnown(*std::move(own), !flags.file_b.empty(), &joined.variance);
    }
    Note(kind.name, ": from ", flags.file, flags.file_b.empty() ? "" : " and ", flags.file_b,
         !flags.variance.empty()  ? ", its noise from " + flags.variance
         : flags.file_b.empty() ? absl::StrCat(", taken as free of noise (", flag, "-b or ", flag,
                                                "-variance)")
                                : ", its noise from their difference");
  } else {
    auto found = FindInHalves(kind);
    if (!found.ok()) return found.status();
    if (!found->has_value()) {
      Note(kind.name, ": none (", flag, "); done without");
      return absl::OkStatus();
    }
    joined = Join((**found)[0], (**found)[1]);
    Note(kind.name, ": from layers of the halves, its noise from their difference");
  }
  Move(std::move(joined.mean), mean);
  Move(std::move(joined.variance), variance);
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<DenoiseInput> ReadHalfImages(const HalvesFlags& flags) {
  return Reader(flags).Run();
}

}  // namespace tessera
