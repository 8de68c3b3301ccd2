// What `tessera`, `tessera-server` and `tessera-worker` are once installed: starts the copy of the
// program that was compiled for the highest x86-64 level of this processor. Copies differ in speed
// only (docs/decisions/0007). Compiled for plain x86-64.
//
// Exit code 2, and one line, where no installed copy runs here.
#include <unistd.h>

#include <cerrno>
#include <climits>
#include <cstdio>
#include <cstring>
#include <string>

#include "core/base/isa_level.h"

namespace {

// The folder of this executable, links resolved; empty when the system does not tell.
std::string OwnFolder() {
  char path[PATH_MAX];
  const ssize_t length = readlink("/proc/self/exe", path, sizeof(path));
  if (length <= 0 || length == ssize_t{sizeof(path)}) return {};
  const std::string own(path, static_cast<size_t>(length));
  return own.substr(0, own.rfind('/'));
}

}  // namespace

int main(int, char** argv) {
  const std::string copies = OwnFolder() + "/" TESSERA_COPIES "/";
  std::string found;
  for (const char* level : {"x86-64-v3", "x86-64-v2"}) {
    const std::string program = copies + level + "/" TESSERA_PROGRAM;
    if (access(program.c_str(), X_OK) != 0) continue;
    if (!tessera::ProcessorRuns(level)) {
      found += found.empty() ? level : std::string(", ") + level;
      continue;
    }
    execv(program.c_str(), argv);
    std::fprintf(stderr, TESSERA_PROGRAM ": cannot start %s: %s\n", program.c_str(),
                 std::strerror(errno));
    return 2;
  }
  if (found.empty()) {
    std::fprintf(stderr, TESSERA_PROGRAM ": no copy of the program in %s: install Tessera again\n",
                 copies.c_str());
  } else {
    std::fprintf(stderr,
                 TESSERA_PROGRAM ": this processor runs none of the installed copies (%s): install "
                 "the one for x86-64-v2 too, as scripts/install does\n",
                 found.c_str());
  }
  return 2;
}
