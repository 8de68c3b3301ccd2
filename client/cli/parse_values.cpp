#include "client/cli/parse_values.h"

#include <cmath>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"

namespace tessera {
namespace {

absl::Status Bad(const std::string& flag, const std::string& text, const std::string& allowed) {
  return absl::InvalidArgumentError(absl::StrCat(flag, " ", text, ": must be ", allowed));
}

// The numbers of "a,b,c", all finite; empty if there are not `count` of them.
std::vector<double> SplitNumbers(const std::string& text, size_t count) {
  std::vector<double> numbers;
  for (const absl::string_view part : absl::StrSplit(text, ',')) {
    double number = 0;
    if (!absl::SimpleAtod(part, &number) || !std::isfinite(number)) return {};
    numbers.push_back(number);
  }
  if (numbers.size() != count) numbers.clear();
  return numbers;
}

}  // namespace

absl::StatusOr<int64_t> ParseInteger(const std::string& flag, const std::string& text, int64_t min,
                                     int64_t max) {
  int64_t value = 0;
  if (!absl::SimpleAtoi(text, &value) || value < min || value > max) {
    return Bad(flag, text, absl::StrCat("a whole number from ", min, " to ", max));
  }
  return value;
}

absl::StatusOr<uint64_t> ParseUnsigned(const std::string& flag, const std::string& text) {
  uint64_t value = 0;
  if (!absl::SimpleAtoi(text, &value)) return Bad(flag, text, "a whole number from 0 to 2^64-1");
  return value;
}

absl::StatusOr<double> ParseNumber(const std::string& flag, const std::string& text, double min,
                                   double max) {
  double value = 0;
  if (!absl::SimpleAtod(text, &value) || !std::isfinite(value) || value < min || value > max) {
    return Bad(flag, text, absl::StrCat("a number from ", min, " to ", max));
  }
  return value;
}

absl::StatusOr<v1::Vec3> ParseVec3(const std::string& flag, const std::string& text) {
  const std::vector<double> numbers = SplitNumbers(text, 3);
  if (numbers.empty()) return Bad(flag, text, "three numbers X,Y,Z with commas and no spaces");
  v1::Vec3 vector;
  vector.set_x(numbers[0]);
  vector.set_y(numbers[1]);
  vector.set_z(numbers[2]);
  return vector;
}

absl::StatusOr<v1::Region> ParseRegion(const std::string& flag, const std::string& text) {
  std::vector<int> numbers;
  for (const absl::string_view part : absl::StrSplit(text, ',')) {
    int number = 0;
    if (!absl::SimpleAtoi(part, &number) || number < 0 || number > kFrameSideMax) break;
    numbers.push_back(number);
  }
  if (numbers.size() != 4 || numbers[2] < 1 || numbers[3] < 1 ||
      absl::StrCat(numbers[0], ",", numbers[1], ",", numbers[2], ",", numbers[3]) != text) {
    return Bad(flag, text, "X,Y,W,H in pixels from the top left, inside the frame, W and H from 1");
  }
  v1::Region region;
  region.set_x(numbers[0]);
  region.set_y(numbers[1]);
  region.set_width(numbers[2]);
  region.set_height(numbers[3]);
  return region;
}

absl::StatusOr<FrameSize> ParseSize(const std::string& flag, const std::string& text) {
  const std::vector<std::string> parts = absl::StrSplit(text, 'x');
  FrameSize size;
  if (parts.size() != 2 || !absl::SimpleAtoi(parts[0], &size.width) ||
      !absl::SimpleAtoi(parts[1], &size.height) || size.width < 1 || size.height < 1 ||
      size.width > kFrameSideMax || size.height > kFrameSideMax ||
      int64_t{size.width} * size.height > kFramePixelsMax) {
    return Bad(flag, text,
               absl::StrCat("WIDTHxHEIGHT such as 1920x1080, each from 1 to ", kFrameSideMax,
                            ", at most ", kFramePixelsMax, " pixels in all"));
  }
  return size;
}

}  // namespace tessera
