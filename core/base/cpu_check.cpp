// Refuses a processor that cannot run this build, before any other code of the program runs: the
// rest is compiled for TESSERA_ISA_LEVEL and would die of an illegal instruction. Compiled for
// plain x86-64 (see CMakeLists.txt).
#include <unistd.h>

#include <cstdlib>

#include "core/base/isa_level.h"

namespace {

__attribute__((constructor(101))) void RefuseOldProcessor() {
  if (tessera::ProcessorRuns(TESSERA_ISA_LEVEL)) return;
  constexpr char kLine[] =
      "error: this processor cannot run programs compiled for " TESSERA_ISA_LEVEL
      ": use a newer one (x86-64-v3 is AVX2, FMA and BMI2, from 2013 on), or build with "
      "-D TESSERA_ISA_LEVEL=x86-64-v2 (SSE4.2, from 2009 on)\n";
  if (write(STDERR_FILENO, kLine, sizeof(kLine) - 1) < 0) _exit(1);
  _exit(2);
}

}  // namespace
