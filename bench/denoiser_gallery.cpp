// Draws the gallery of docs/denoiser-gallery.md: for each way in which denoisers fail one strip of
// pictures, and prints each filter's relMSE over the raw mean's.
//   denoiser_gallery FOLDER
#include <array>
#include <cstdio>
#include <string>
#include <utility>
#include <vector>

#include "core/denoise/denoise_frame.h"
#include "core/image/png_writer.h"
#include "tests/core/denoise/failure_frames.h"

namespace tessera {
namespace {

constexpr uint32_t kSeed = 1;
constexpr int kGapPx = 4;
constexpr int kSidePx = 64;  // of a picture; of larger frames the corner around the middle
constexpr int kZoom = 2;
constexpr const char* kFilters[] = {"geometric", "bilateral", "regression"};

// Copies the middle of `from`, enlarged, to column `x_begin` of the strip.
void Paste(const Planes3& from, const PixelRect& bounds, int x_begin, Image* strip) {
  const int x_from = (bounds.width() - kSidePx) / 2, y_from = (bounds.height() - kSidePx) / 2;
  for (size_t c = 0; c < 3; ++c) {
    for (int y = 0; y < strip->height(); ++y) {
      for (int x = 0; x < kSidePx * kZoom; ++x) {
        const auto p = static_cast<size_t>(bounds.IndexOf(x_from + x / kZoom, y_from + y / kZoom));
        strip->channels[c].floats[static_cast<size_t>(y * strip->width() + x_begin + x)] =
            from[c][p];
      }
    }
  }
}

absl::Status Draw(const FailureFrame& failure, const std::string& folder) {
  const SyntheticFrame frame = failure.make(kSeed);
  const PixelRect& bounds = frame.planes.bounds;
  std::vector<Planes3> pictures = {frame.planes.color};
  const double raw = RelativeError(frame.planes.color, frame.truth);
  std::string row = "| `" + std::string(failure.name) + "` |";
  for (const char* name : kFilters) {
    const auto denoiser = MakeDenoiser(name);
    if (!denoiser.ok()) return denoiser.status();
    FilteredPlanes out = DenoiseFrame(**denoiser, frame.planes, DenoiseQuality::kFinal, 2);
    std::array<char, 32> cell{};
    std::snprintf(cell.data(), cell.size(), " %.3g |", RelativeError(out.color, frame.truth) / raw);
    row += cell.data();
    pictures.push_back(std::move(out.color));
  }
  pictures.push_back(frame.truth);
  std::printf("%s\n", row.c_str());
  std::fflush(stdout);
  const int step = kSidePx * kZoom + kGapPx;
  Image strip;
  strip.data_window = strip.display_window =
      PixelRect::FromSize(0, 0, step * static_cast<int>(pictures.size()) - kGapPx, kSidePx * kZoom);
  for (const char* channel : {"R", "G", "B"}) {
    strip.Add(channel, std::vector<float>(static_cast<size_t>(strip.data_window.area()), 1.0f));
  }
  for (size_t i = 0; i < pictures.size(); ++i) {
    Paste(pictures[i], bounds, step * static_cast<int>(i), &strip);
  }
  return WritePng(folder + "/" + std::string(failure.name) + ".png", strip, {});
}

}  // namespace
}  // namespace tessera

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fprintf(stderr, "usage: denoiser_gallery FOLDER\n");
    return 2;
  }
  std::printf("| relMSE over the input's | geometric | bilateral | regression |\n"
              "|---|---|---|---|\n");
  for (const tessera::FailureFrame& failure : tessera::FailureFrames()) {
    const absl::Status status = tessera::Draw(failure, argv[1]);
    if (!status.ok()) {
      std::fprintf(stderr, "%s\n", std::string(status.message()).c_str());
      return 2;
    }
  }
}
