#include "core/film/pixel_sample.h"

#include <cmath>

namespace tessera {
namespace {

// False for NaN, too.
bool Within(float value, float limit) { return std::fabs(value) <= limit; }

bool AllWithin(const float (&values)[3], float limit) {
  return Within(values[0], limit) && Within(values[1], limit) && Within(values[2], limit);
}

}  // namespace

bool ReplaceNonFinite(PixelSample* sample) {
  const bool radiance_ok = AllWithin(sample->radiance, kRadianceMax);
  const bool features_ok = AllWithin(sample->albedo, kRadianceMax) &&
                           AllWithin(sample->normal, kRadianceMax) &&
                           Within(sample->depth, kRadianceMax);
  if (radiance_ok && features_ok) return false;
  *sample = PixelSample{};
  return true;
}

}  // namespace tessera
