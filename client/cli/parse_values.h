// Values of flags: checked, with one line naming flag, value and what is allowed.
// All errors are INVALID_ARGUMENT.
#pragma once

#include <cstdint>
#include <string>

#include "absl/status/statusor.h"
#include "tessera/v1/job.pb.h"

namespace tessera {

absl::StatusOr<int64_t> ParseInteger(const std::string& flag, const std::string& text, int64_t min,
                                     int64_t max);
absl::StatusOr<uint64_t> ParseUnsigned(const std::string& flag, const std::string& text);
// Finite, in [min, max].
absl::StatusOr<double> ParseNumber(const std::string& flag, const std::string& text, double min,
                                   double max);
// "X,Y,Z".
absl::StatusOr<v1::Vec3> ParseVec3(const std::string& flag, const std::string& text);
// "X,Y,W,H", inside nothing yet: x, y >= 0; w, h >= 1.
absl::StatusOr<v1::Region> ParseRegion(const std::string& flag, const std::string& text);

struct FrameSize {
  int width = 0;
  int height = 0;
};
// "WxH", each 1 to kFrameSideMax, at most kFramePixelsMax pixels.
inline constexpr int kFrameSideMax = 65536;
inline constexpr int64_t kFramePixelsMax = int64_t{1} << 28;
absl::StatusOr<FrameSize> ParseSize(const std::string& flag, const std::string& text);

}  // namespace tessera
