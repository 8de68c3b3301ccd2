// Checks and completes what a client asks for.
#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "core/base/pixel_rect.h"
#include "core/film/film.h"
#include "tessera/v1/job.pb.h"

namespace tessera {

// What stands in for fields that a client left empty.
struct SettingsDefaults {
  int tile_size = 32;
  int64_t feature_spp = 64;            // docs/decisions/0004
  std::vector<std::string> denoisers;  // known names, the default first
};

// The classes that workers may be asked for, the default first.
const std::vector<std::string>& IsaClasses();

// Returns `settings` with every default filled in.
// Errors: INVALID_ARGUMENT naming the field, its value and the remedy.
absl::StatusOr<v1::JobSettings> CompleteSettings(v1::JobSettings settings,
                                                 const SettingsDefaults& defaults);

// Whether the region lies inside the frame. Errors: INVALID_ARGUMENT naming `field`.
absl::Status CheckRegion(const v1::JobSettings& settings, const v1::Region& region,
                         const char* field);

// Whether the job's samples go where its picture needs them, with complete settings.
bool IsAdaptive(const v1::JobSettings& settings);
// Whether the job ends at some estimated error.
bool HasTargetError(const v1::JobSettings& settings);
// Whether what the job renders, or when it ends, rests on its picture.
bool DecidesByPicture(const v1::JobSettings& settings);

// A film without samples for a job with complete settings.
Film EmptyFilmOf(const v1::JobSettings& settings);

// The pixels that a job with complete settings renders.
PixelRect RegionOf(const v1::JobSettings& settings);
PixelRect RectOf(const v1::Region& region);
v1::Region RegionProto(const PixelRect& rect);

}  // namespace tessera
