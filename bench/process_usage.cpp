#include "bench/process_usage.h"

#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <sstream>
#include <string>
#include <system_error>

namespace tessera {
namespace {

std::string ProcFolder(pid_t pid) { return "/proc/" + std::to_string(pid); }

// The process and its living descendants.
void ForEachOf(pid_t pid, const std::function<void(pid_t)>& visit) {
  visit(pid);
  std::error_code error;
  for (const auto& thread : std::filesystem::directory_iterator(ProcFolder(pid) + "/task", error)) {
    std::ifstream children(thread.path() / "children");
    for (pid_t child; children >> child;) ForEachOf(child, visit);
  }
}

}  // namespace

double CpuSecondsOf(pid_t pid) {
  double ticks = 0;
  ForEachOf(pid, [&](pid_t each) {
    std::ifstream file(ProcFolder(each) + "/stat");
    const std::string line((std::istreambuf_iterator<char>(file)), {});
    if (line.empty()) return;                                     // it has just ended
    std::istringstream fields(line.substr(line.rfind(')') + 2));  // from field 3 on
    std::string field;
    for (int i = 3; i < 14; ++i) fields >> field;
    // utime, stime, and those of children that have ended and been waited for.
    for (int i = 0; i < 4; ++i) {
      double value = 0;
      fields >> value;
      ticks += value;
    }
  });
  return ticks / static_cast<double>(sysconf(_SC_CLK_TCK));
}

int64_t PeakBytesOf(pid_t pid) {
  int64_t bytes = 0;
  ForEachOf(pid, [&](pid_t each) {
    std::ifstream file(ProcFolder(each) + "/status");
    for (std::string line; std::getline(file, line);) {
      if (line.starts_with("VmHWM:")) bytes += std::stoll(line.substr(6)) * 1024;
    }
  });
  return bytes;
}

}  // namespace tessera
