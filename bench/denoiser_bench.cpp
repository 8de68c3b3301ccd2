// How good a filter is where the truth is known (docs/denoiser.md): for each input its error, what
// it says of its own error, how often its 95 % intervals hold the truth and how wide they are, in
// how many 32x32 blocks it does harm, what it costs, and what it adds to the picture's sum, in
// percent of the raw one's.
//   denoiser_bench INPUT=REFERENCE[,REFERENCE] ... [--denoiser NAME] [--threads N] [--repeat N]
//     [--set OPTION=VALUE ...] [--update] [--sensitivity]
// INPUT is a film (tessera render --layers film), or a folder of another renderer's images: color,
// albedo, normal and depth, each as NAME.exr, NAMEA.exr, NAMEB.exr and NAMEVariance.exr.
// --update adds what it costs to bring the picture up to date after news in one tile of 64x64;
// --sensitivity what half and twice each of the filter's constants change, as a table.
// With two independent references their noise is taken out; with one, harm alone is free of it.
#include <CLI/CLI.hpp>
#include <sys/resource.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "core/base/tile_grid.h"
#include "core/denoise/confidence.h"
#include "core/denoise/denoise_frame.h"
#include "core/denoise/frame_filter.h"
#include "core/film/film.h"
#include "core/image/film_file.h"
#include "core/image/image_reader.h"
#include "core/statistics/calibration.h"
#include "tests/core/denoise/harm.h"

namespace tessera {
namespace {

constexpr int kTruthRadiusPx = 2;      // the true squared error is averaged over 5x5 pixels
constexpr int kReferenceRadiusPx = 4;  // the references' variance over 9x9

struct Options {
  std::vector<std::string> inputs;
  std::string denoiser;
  std::vector<std::string> constants;
  bool sensitivity = false;
  int threads = 1;
  int repeat = 1;
  bool update = false;
};

double UserSeconds() {
  rusage usage;
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_utime.tv_sec) +
         1e-6 * static_cast<double>(usage.ru_utime.tv_usec);
}

absl::StatusOr<Planes3> ReadColor(const std::string& path, bool is_raw) {
  const absl::StatusOr<Image> image = ReadImage(path);
  if (!image.ok()) return image.status();
  Planes3 color;
  const char* const names[] = {"R", "G", "B"};
  const char* const axes[] = {"X", "Y", "Z"};
  for (size_t c = 0; c < 3; ++c) {
    const ImageChannel* channel = nullptr;
    if (is_raw) channel = image->Find(absl::StrCat("raw.", names[c]));
    if (channel == nullptr) channel = image->Find(names[c]);
    if (channel == nullptr) channel = image->Find(axes[c]);
    if (channel == nullptr) {
      return absl::InvalidArgumentError(absl::StrCat(path, " has no channel ", names[c]));
    }
    color[c] = channel->floats;
  }
  return color;
}

// The variance of the mean of two halves where the stored one underflowed.
void RepairVariance(const Plane& a, const Plane& b, Plane* variance) {
  for (size_t i = 0; i < variance->size(); ++i) {
    if ((*variance)[i] > 0) continue;
    (*variance)[i] = (a[i] - b[i]) * (a[i] - b[i]) / 4;
  }
}

absl::StatusOr<FramePlanes> ReadFolder(const std::string& folder) {
  const absl::StatusOr<Image> shape = ReadImage(folder + "/color.exr");
  if (!shape.ok()) return shape.status();
  FramePlanes planes(PixelRect::FromSize(0, 0, shape->width(), shape->height()));
  Planes3 depth, depth_variance;
  struct Target {
    std::string name;
    Planes3* to;
  };
  const Target targets[] = {{"color", &planes.color},
                            {"colorA", &planes.color_half[0]},
                            {"colorB", &planes.color_half[1]},
                            {"colorVariance", &planes.sample_variance_of_mean},
                            {"albedo", &planes.albedo},
                            {"albedoVariance", &planes.albedo_variance},
                            {"normal", &planes.normal},
                            {"normalVariance", &planes.normal_variance},
                            {"depth", &depth},
                            {"depthVariance", &depth_variance}};
  for (const Target& target : targets) {
    const std::string path = absl::StrCat(folder, "/", target.name, ".exr");
    absl::StatusOr<Planes3> color = ReadColor(path, false);
    if (!color.ok()) return color.status();
    *target.to = *std::move(color);
  }
  planes.depth = depth[0];
  planes.depth_variance = depth_variance[0];
  for (size_t c = 0; c < 3; ++c) {
    RepairVariance(planes.color_half[0][c], planes.color_half[1][c],
                   &planes.sample_variance_of_mean[c]);
  }
  std::ranges::fill(planes.samples, 4u);
  std::ranges::fill(planes.coverage, 1.0f);
  CalibrateVariance(planes.bounds, &planes);
  return planes;
}

absl::StatusOr<FramePlanes> ReadFilm(const std::string& path) {
  const absl::StatusOr<FilmFile> file = ReadFilmFile(path);
  if (!file.ok()) return file.status();
  int tile_size = 1;  // of the nodes: all tiles but those at the border
  for (const TileStatistics& node : file->nodes) {
    tile_size = std::max({tile_size, node.window().width(), node.window().height()});
  }
  const TileGrid grid(file->region, tile_size);
  Film film(grid, file->feature_end);
  for (const TileStatistics& node : file->nodes) {
    const PixelRect& window = node.window();
    const absl::Status accepted =
        film.Accept(grid.TilesIn(PixelRect::FromSize(window.x_begin, window.y_begin, 1, 1))[0],
                    node);
    if (!accepted.ok()) return accepted;
  }
  FramePlanes planes(file->region);
  for (int64_t tile = 0; tile < grid.num_tiles(); ++tile) planes.Resolve(film.Fold(tile));
  CalibrateVariance(planes.bounds, &planes);
  return planes;
}

// Two references; the same one twice if there is no other.
struct Truth {
  Planes3 first, second;

  double Error(double value, size_t c, size_t i) const {
    return (value - double{first[c][i]}) * (value - double{second[c][i]});
  }
  double Mean(size_t c, size_t i) const {
    return (double{first[c][i]} + double{second[c][i]}) / 2;
  }
  double Scale(size_t c, size_t i) const { return 1 / (Mean(c, i) * Mean(c, i) + 0.01); }
};

// The mean of a function of pixels over the square around (x, y).
template <typename Value>
double Around(const PixelRect& bounds, int x, int y, int radius_px, const Value& value) {
  const PixelRect near = PixelRect::FromSize(x, y, 1, 1).Expand(radius_px).Intersect(bounds);
  double sum = 0;
  for (int row = near.y_begin; row < near.y_end; ++row) {
    for (int column = near.x_begin; column < near.x_end; ++column) {
      sum += value(static_cast<size_t>(bounds.IndexOf(column, row)));
    }
  }
  return sum / static_cast<double>(near.area());
}

struct Row {
  double raw = 0, rel_mse = 0, trimmed = 0, promised = 0;
  double added = 0;  // to the sum of the raw picture, as a part of it
  double coverage = 0, width = 0;
  int num_blocks = 0, num_harmed = 0;
  double worst_block = 0;
};

void MeasureErrors(const FramePlanes& planes, const FilteredPlanes& out, const Truth& truth,
                   Row* row) {
  const size_t num_pixels = out.color[0].size();
  std::vector<double> pixels(num_pixels);
  double promised = 0, noise = 0, raw_sum = 0, sum = 0;
  for (size_t i = 0; i < num_pixels; ++i) {
    for (size_t c = 0; c < 3; ++c) {
      raw_sum += double{planes.color[c][i]};
      sum += double{out.color[c][i]};
      pixels[i] += truth.Error(double{out.color[c][i]}, c, i) * truth.Scale(c, i) / 3;
      row->raw += truth.Error(double{planes.color[c][i]}, c, i) * truth.Scale(c, i) / 3;
    }
    promised += double{out.relative_error[i]} / 3;
    noise += double{out.relative_noise[i]} / 3;
  }
  const auto n = static_cast<double>(num_pixels);
  std::ranges::sort(pixels);
  const size_t kept = num_pixels - num_pixels / 1000;
  for (size_t i = 0; i < num_pixels; ++i) {
    row->rel_mse += pixels[i] / n;
    if (i < kept) row->trimmed += pixels[i] / static_cast<double>(kept);
  }
  row->raw /= n;
  row->promised = std::max(promised, noise) / n;
  row->added = sum / raw_sum - 1;
}

void MeasureIntervals(const FilteredPlanes& out, const Truth& truth, Row* row) {
  const PixelRect& bounds = out.bounds;
  double num_inside = 0, num_values = 0, width = 0, deviation = 0;
  for (int y = bounds.y_begin; y < bounds.y_end; ++y) {
    for (int x = bounds.x_begin; x < bounds.x_end; ++x) {
      const auto i = static_cast<size_t>(bounds.IndexOf(x, y));
      for (size_t c = 0; c < 3; ++c) {
        if (!(out.error[c][i] < kInfinity) || out.error[c][i] == 0) continue;
        const double of_reference =
            Around(bounds, x, y, kReferenceRadiusPx, [&](size_t k) {
              const double d = double{truth.first[c][k]} - double{truth.second[c][k]};
              return d * d / 4;
            });
        const double sigma = double{out.error[c][i]} / double{kNormalQuantile975};
        const double half_width =
            double{kNormalQuantile975} * std::sqrt(sigma * sigma + of_reference);
        num_inside += std::abs(double{out.color[c][i]} - truth.Mean(c, i)) <= half_width;
        num_values += 1;
        width += double{out.error[c][i]};
        deviation += std::sqrt(std::max(0.0, Around(bounds, x, y, kTruthRadiusPx, [&](size_t k) {
          return truth.Error(double{out.color[c][k]}, c, k);
        })));
      }
    }
  }
  row->coverage = num_inside / num_values;
  row->width = width / (double{kNormalQuantile975} * deviation);
}

void MeasureHarm(const FramePlanes& planes, const FilteredPlanes& out, const Truth& truth,
                 Row* row) {
  const std::vector<BlockHarm> blocks = HarmOfBlocks(
      out.bounds, out.color, planes.color,
      [&](double value, size_t c, size_t i) { return truth.Error(value, c, i); });
  row->num_blocks = static_cast<int>(blocks.size());
  row->num_harmed = CountHarmed(blocks);
  for (const BlockHarm& block : blocks) row->worst_block = std::max(row->worst_block, block.ratio);
}

// Moves what the samples of `news` say by half of its standard deviation, as more samples would.
void MakeNews(const PixelRect& news, std::mt19937* random, FramePlanes* planes) {
  std::normal_distribution<float> normal(0, 0.5f);
  const auto move = [&](float variance, float* value) {
    *value += normal(*random) * std::sqrt(std::max(variance, 0.0f));
  };
  for (int y = news.y_begin; y < news.y_end; ++y) {
    for (int x = news.x_begin; x < news.x_end; ++x) {
      const auto i = static_cast<size_t>(planes->bounds.IndexOf(x, y));
      for (size_t c = 0; c < 3; ++c) {
        float& first = planes->color_half[0][c][i];
        float& second = planes->color_half[1][c][i];
        const float before = (first + second) / 2;
        for (float* const half : {&first, &second}) {
          move(2 * planes->sample_variance_of_mean[c][i], half);
        }
        planes->color[c][i] += (first + second) / 2 - before;
        move(planes->albedo_variance[c][i], &planes->albedo[c][i]);
        move(planes->normal_variance[c][i], &planes->normal[c][i]);
      }
      move(planes->depth_variance[i], &planes->depth[i]);
    }
  }
  CalibrateVariance(news.Expand(kCalibrationRadiusPx).Intersect(planes->bounds), planes);
}

// Seconds of CPU per pixel of a tile to bring the whole filtered picture up to date after news in
// it, and the bytes per pixel of the frame that this takes: the mean of the tiles whose reach lies
// in the frame, or of all.
void MeasureUpdate(FramePlanes planes, const Denoiser& denoiser) {
  constexpr int kTilePx = 64;
  const PixelRect& bounds = planes.bounds;
  const auto filter = denoiser.MakeFrameFilter({bounds, DenoiseQuality::kFinal}, bounds);
  const auto one_by_one = [](size_t count, const std::function<void(size_t)>& body) {
    for (size_t i = 0; i < count; ++i) body(i);
  };
  FilteredPlanes out(bounds);
  const auto put = [&](const FilteredPlanes& part) { CopyPixels(part, &out); };
  filter->Filter(planes, {&bounds, 1}, one_by_one, put);
  const TileGrid grid(bounds, kTilePx);
  std::mt19937 random(1);
  double whole_seconds = 0, cut_seconds = 0, whole_pixels = 0, cut_pixels = 0;
  for (int64_t tile = 0; tile < grid.num_tiles(); ++tile) {
    const PixelRect news = grid.WindowOf(tile);
    const PixelRect reached = news.Expand(filter->reach_px());
    const bool is_whole = bounds.Contains(reached);
    const PixelRect window = reached.Intersect(bounds);
    MakeNews(news, &random, &planes);
    const double begin = UserSeconds();
    filter->Invalidate(news);
    filter->Filter(planes, {&window, 1}, one_by_one, put);
    (is_whole ? whole_seconds : cut_seconds) += UserSeconds() - begin;
    (is_whole ? whole_pixels : cut_pixels) += static_cast<double>(news.area());
  }
  const bool has_whole = whole_pixels > 0;
  std::printf("%-18s %9.2f us per pixel of a changed tile%s, %.0f bytes kept a pixel\n", "  update",
              1e6 * (has_whole ? whole_seconds / whole_pixels : cut_seconds / cut_pixels),
              has_whole ? "" : " (cut by the frame)",
              static_cast<double>(filter->kept_bytes()) / static_cast<double>(bounds.area()));
}

// What the filter is measured on.
struct Input {
  std::string name;
  FramePlanes planes;
  Truth truth;
};

absl::StatusOr<Input> ReadInput(const std::string& text) {
  const std::vector<std::string> parts = absl::StrSplit(text, absl::MaxSplits('=', 1));
  const std::vector<std::string> references = absl::StrSplit(parts.back(), ',');
  if (parts.size() != 2 || references.size() > 2) {
    return absl::InvalidArgumentError(text + ": must be INPUT=REFERENCE or INPUT=FIRST,SECOND");
  }
  absl::StatusOr<FramePlanes> planes =
      std::filesystem::is_directory(parts[0]) ? ReadFolder(parts[0]) : ReadFilm(parts[0]);
  if (!planes.ok()) return planes.status();
  absl::StatusOr<Planes3> first = ReadColor(references.front(), true);
  absl::StatusOr<Planes3> second = ReadColor(references.back(), true);
  if (!first.ok()) return first.status();
  if (!second.ok()) return second.status();
  Input input{std::filesystem::path(parts[0]).stem().string(), *std::move(planes),
              {*std::move(first), *std::move(second)}};
  if (input.truth.first[0].size() != input.planes.samples.size() ||
      input.truth.second[0].size() != input.planes.samples.size()) {
    return absl::InvalidArgumentError(text + ": the reference has another size");
  }
  return input;
}

void Measure(const Options& options, const Denoiser& denoiser, const Input& input) {
  FilteredPlanes out;
  double seconds = 1e30;
  for (int round = 0; round < options.repeat; ++round) {
    const double begin = UserSeconds();
    out = DenoiseFrame(denoiser, input.planes, DenoiseQuality::kFinal, options.threads);
    seconds = std::min(seconds, UserSeconds() - begin);
  }
  Row row;
  MeasureErrors(input.planes, out, input.truth, &row);
  MeasureIntervals(out, input.truth, &row);
  MeasureHarm(input.planes, out, input.truth, &row);
  std::printf("%-18s %9.1f %8.2f %8.2f  %5.2f  %5.1f %5.2f  %3d/%-4d %5.2f  %6.2f %+6.2f\n",
              input.name.c_str(), 1e5 * row.raw, 1e5 * row.rel_mse, 1e5 * row.trimmed,
              std::sqrt(std::max(row.rel_mse, 0.0) / row.promised), 100 * row.coverage, row.width,
              row.num_harmed, row.num_blocks, row.worst_block,
              1e6 * seconds / static_cast<double>(input.planes.samples.size()),
              100 * row.added);
  if (options.update) MeasureUpdate(input.planes, denoiser);
  std::fflush(stdout);
}

// relMSE, plain and trimmed.
std::array<double, 2> Errors(const Options& options, const Denoiser& denoiser, const Input& input) {
  Row row;
  MeasureErrors(input.planes,
                DenoiseFrame(denoiser, input.planes, DenoiseQuality::kFinal, options.threads),
                input.truth, &row);
  return {row.rel_mse, row.trimmed};
}

// What half and twice each constant change on each input, in percent: of relMSE, in brackets of
// trimmed relMSE.
void PrintSensitivity(const Options& options, const std::vector<Input>& inputs,
                      Denoiser* denoiser) {
  std::printf("| constant | value |");
  for (const Input& input : inputs) std::printf(" %s |", input.name.c_str());
  std::printf("\n|---|---|");
  std::vector<std::array<double, 2>> before;
  for (const Input& input : inputs) {
    std::printf("---|");
    before.push_back(Errors(options, *denoiser, input));
  }
  std::printf("\n");
  const std::vector<DenoiserOption> all = denoiser->options();
  for (size_t k = 0; k < all.size(); ++k) {
    const DenoiserOption& option = all[k];
    for (const float factor : {0.5f, 2.0f}) {
      const float value = std::clamp(factor * option.value, option.min, option.max);
      if (!denoiser->SetOption(option.name, value).ok()) continue;
      // What it has become: some are whole numbers.
      std::printf("| %s | %g instead of %g |", option.name.c_str(),
                  double{denoiser->options()[k].value}, double{option.value});
      for (size_t i = 0; i < inputs.size(); ++i) {
        const std::array<double, 2> now = Errors(options, *denoiser, inputs[i]);
        std::printf(" %+.1f (%+.1f) |", 100 * (now[0] / before[i][0] - 1),
                    100 * (now[1] / before[i][1] - 1));
      }
      std::printf("\n");
      std::fflush(stdout);
    }
    if (!denoiser->SetOption(option.name, option.value).ok()) return;
  }
}

absl::Status SetConstants(const std::vector<std::string>& constants, Denoiser* denoiser) {
  for (const std::string& text : constants) {
    const std::vector<std::string> parts = absl::StrSplit(text, absl::MaxSplits('=', 1));
    float value = 0;
    if (parts.size() != 2 || !absl::SimpleAtof(parts[1], &value)) {
      return absl::InvalidArgumentError(text + ": must be OPTION=VALUE");
    }
    const absl::Status set = denoiser->SetOption(parts[0], value);
    if (!set.ok()) return set;
  }
  return absl::OkStatus();
}

// Errors: of the inputs, of the filter's name or options.
absl::Status Run(const Options& options) {
  const absl::StatusOr<std::unique_ptr<Denoiser>> denoiser =
      MakeDenoiser(options.denoiser.empty() ? DenoiserNames().front() : options.denoiser);
  if (!denoiser.ok()) return denoiser.status();
  const absl::Status set = SetConstants(options.constants, denoiser->get());
  if (!set.ok()) return set;
  std::vector<Input> inputs;
  for (const std::string& text : options.inputs) {
    absl::StatusOr<Input> input = ReadInput(text);
    if (!input.ok()) return input.status();
    inputs.push_back(*std::move(input));
  }
  if (options.sensitivity) {
    PrintSensitivity(options, inputs, denoiser->get());
    return absl::OkStatus();
  }
  std::printf("%-18s %9s %8s %8s  %5s  %5s %5s  %8s %5s  %6s %6s\n", "relMSE x 1e5", "raw",
              "filter", "trimmed", "t/p", "cover", "width", "harmed", "worst", "us/px", "energy");
  for (const Input& input : inputs) Measure(options, **denoiser, input);
  return absl::OkStatus();
}

}  // namespace
}  // namespace tessera

int main(int argc, char** argv) {
  tessera::Options options;
  CLI::App app("Error, honesty, harm and cost of a filter where the truth is known");
  app.add_option("inputs", options.inputs, "INPUT=REFERENCE[,REFERENCE]")->required();
  app.add_option("--denoiser", options.denoiser);
  app.add_option("--threads", options.threads);
  app.add_option("--repeat", options.repeat, "The fastest counts");
  app.add_flag("--update", options.update, "The cost of news in one tile");
  app.add_option("--set", options.constants, "OPTION=VALUE of the filter")
      ->take_all()
      ->allow_extra_args(false);
  app.add_flag("--sensitivity", options.sensitivity, "What half and twice each constant change");
  CLI11_PARSE(app, argc, argv);
  const absl::Status status = tessera::Run(options);
  if (status.ok()) return 0;
  std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return 2;
}
