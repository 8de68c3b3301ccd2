#include "worker/session/host_resources.h"

#include <unistd.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <charconv>
#include <cmath>
#include <fstream>
#include <thread>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"

namespace tessera {

std::string MachineName() {
  std::array<char, 256> name = {};
  if (gethostname(name.data(), name.size() - 1) != 0) return "unknown";
  return name.data();
}

int MachineThreads() { return std::max(1u, std::thread::hardware_concurrency()); }

int64_t MachineMemoryBytes() {
  int64_t bytes = int64_t{sysconf(_SC_PHYS_PAGES)} * sysconf(_SC_PAGE_SIZE);
  int64_t group_bytes = 0;
  std::ifstream group("/sys/fs/cgroup/memory.max");  // "max" or a number
  if (group >> group_bytes && group_bytes > 0) bytes = std::min(bytes, group_bytes);
  return bytes;
}

absl::StatusOr<int64_t> ParseByteSize(std::string_view text) {
  const auto error = [&] {
    return absl::InvalidArgumentError(absl::StrCat(
        "'", std::string(text), "' is not a size; write bytes or, for example, 512M, 8G or 1.5T"));
  };
  double number = 0;
  const auto [end, code] =
      std::from_chars(text.data(), text.data() + text.size(), number, std::chars_format::fixed);
  if (code != std::errc() || !(number >= 0)) return error();
  std::string_view unit(end, static_cast<size_t>(text.data() + text.size() - end));
  constexpr std::string_view kUnits = "KMGT";
  double scale = 1;
  if (!unit.empty() && unit != "B") {
    const int letter = std::toupper(static_cast<unsigned char>(unit.front()));
    const size_t power = kUnits.find(static_cast<char>(letter));
    const std::string_view rest = unit.substr(1);
    if (power == std::string_view::npos || !(rest.empty() || rest == "B" || rest == "iB")) {
      return error();
    }
    scale = std::ldexp(1.0, 10 * (static_cast<int>(power) + 1));
  }
  const double bytes = number * scale;
  if (bytes > 0x1p62) return error();
  return static_cast<int64_t>(bytes);
}

}  // namespace tessera
