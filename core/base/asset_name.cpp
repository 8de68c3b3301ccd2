#include "core/base/asset_name.h"

#include <algorithm>
#include <cstddef>
#include <vector>

#include "absl/status/status.h"

namespace tessera {
namespace {

int HexDigit(char c) {
  if (c >= '0' && c <= '9') return c - '0';
  if (c >= 'a' && c <= 'f') return c - 'a' + 10;
  if (c >= 'A' && c <= 'F') return c - 'A' + 10;
  return -1;
}

bool IsSchemeCharacter(char c) {
  return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '+' ||
         c == '-' || c == '.';
}

bool HasScheme(std::string_view uri) {
  const size_t colon = uri.find(':');
  return colon != std::string_view::npos && colon != 0 &&
         std::all_of(uri.begin(), uri.begin() + static_cast<std::ptrdiff_t>(colon),
                     IsSchemeCharacter);
}

std::string PercentDecode(std::string_view uri) {
  std::string name;
  for (size_t i = 0; i < uri.size(); ++i) {
    const int high = uri[i] == '%' && i + 2 < uri.size() ? HexDigit(uri[i + 1]) : -1;
    const int low = high >= 0 ? HexDigit(uri[i + 2]) : -1;
    if (low < 0) {
      name.push_back(uri[i]);
      continue;
    }
    name.push_back(static_cast<char>(high * 16 + low));
    i += 2;
  }
  return name;
}

}  // namespace

absl::StatusOr<std::string> AssetNameFromUri(std::string_view uri) {
  if (HasScheme(uri)) {
    return absl::InvalidArgumentError(
        "is not a file beside the scene, and nothing is downloaded: put it there and name it "
        "relatively");
  }
  std::string decoded = PercentDecode(uri);
  if (decoded.find('\0') != std::string::npos) {
    return absl::InvalidArgumentError("has a zero byte: rename the file");
  }
  std::replace(decoded.begin(), decoded.end(), '\\', '/');
  std::vector<std::string> parts;
  bool leaves = decoded.starts_with('/');
  for (size_t begin = 0; begin <= decoded.size() && !leaves;) {
    const size_t end = std::min(decoded.find('/', begin), decoded.size());
    std::string part = decoded.substr(begin, end - begin);
    begin = end + 1;
    if (part.empty() || part == ".") continue;
    if (part != "..") {
      parts.push_back(std::move(part));
    } else if (parts.empty()) {
      leaves = true;
    } else {
      parts.pop_back();
    }
  }
  if (leaves) {
    return absl::InvalidArgumentError(
        "leaves the scene's folder: move the file below it and name it relatively");
  }
  if (parts.empty()) return absl::InvalidArgumentError("names no file: export the scene again");
  std::string name = parts.front();
  for (size_t i = 1; i < parts.size(); ++i) name += "/" + parts[i];
  return name;
}

}  // namespace tessera
