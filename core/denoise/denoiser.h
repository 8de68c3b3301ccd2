// The interface of all filters. A filter sees planes around a window and writes the window; it does
// not know whether the window is a tile or the frame, so tiled equals whole, bit for bit.
#pragma once

#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/film/frame_planes.h"

namespace tessera {

enum class DenoiseQuality { kPreview, kFinal };

// Values that hold for the whole frame, handed in so that no tile computes its own.
struct FrameParameters {
  PixelRect frame;  // what exists: a halo is cut here
  DenoiseQuality quality = DenoiseQuality::kFinal;
};

// Filtered planes over a rectangle, row-major.
struct FilteredPlanes {
  FilteredPlanes() = default;
  explicit FilteredPlanes(const PixelRect& bounds);

  PixelRect bounds;
  Planes3 color;
  Planes3 error;  // half-width of the 95 % interval of `color`; +inf where unknown
  // The squared error relative to the squared value + kRelMseEpsilon, summed over channels (relMSE
  // times 3), to be summed over many pixels: right on average as far as the filter can tell, so not
  // clamped and possibly negative. +inf where unknown.
  Plane relative_error;
  // A part of it that is noise for certain, >= 0: what a sum may not fall below.
  Plane relative_noise;
};

// The floor of relative errors (DESIGN, relMSE).
inline constexpr float kRelMseEpsilon = 0.01f;

// Fills relative_error over `window` from color and error, and sets relative_noise to 0: for
// filters whose intervals are all they know.
void SetRelativeError(const PixelRect& window, FilteredPlanes* out);

// A number of a filter that can be set by hand, for charts of what its choice is worth.
struct DenoiserOption {
  std::string name;
  std::string text;
  float value = 0;  // now
  float min = 0;    // of what it can be set to, both included
  float max = 0;
};

// Copies all of `from` into `to`, which must contain it.
void CopyPixels(const FilteredPlanes& from, FilteredPlanes* to);

class FrameFilter;

class Denoiser {
 public:
  virtual ~Denoiser() = default;
  virtual std::string_view name() const = 0;
  // Pixels around a window that Filter reads at `quality`, not counting what planes.variance was
  // calibrated from.
  virtual int halo_px(DenoiseQuality quality) const = 0;
  // The side of the windows into which large areas are best split: large against the halo.
  virtual int window_px(DenoiseQuality /*quality*/) const { return 128; }
  // Writes the pixels of `window` of `out` from `planes`, whose bounds contain the window expanded
  // by halo_px(parameters.quality) and cut at parameters.frame. Pixels without samples are filled
  // or left zero with an infinite error. Threads: const, any number at once on disjoint windows.
  virtual void Filter(const FramePlanes& planes, const FrameParameters& parameters,
                      const PixelRect& window, FilteredPlanes* out) const = 0;
  // A filter of the whole frame, window by window and again and again as its planes change, which
  // may keep what helps (core/denoise/frame_filter.h); the same bits as Filter's. `bounds`: of the
  // planes that it will get. This denoiser must outlive it.
  virtual std::unique_ptr<FrameFilter> MakeFrameFilter(const FrameParameters& parameters,
                                                       const PixelRect& bounds) const;
  // What SetOption knows; most filters have nothing to set.
  virtual std::vector<DenoiserOption> options() const { return {}; }
  // Errors: INVALID_ARGUMENT naming the options and their ranges.
  absl::Status SetOption(std::string_view option, float value);

 protected:
  // Sets option `index` of options() to a value inside its range.
  virtual void SetOptionAt(size_t /*index*/, float /*value*/) {}
};

// Names that MakeDenoiser knows, the default first; "none" copies the mean.
std::vector<std::string> DenoiserNames();
// Errors: INVALID_ARGUMENT listing the names.
absl::StatusOr<std::unique_ptr<Denoiser>> MakeDenoiser(std::string_view name);

}  // namespace tessera
