// Refuses a processor that cannot run this build, before any other code of the program runs: the
// rest is compiled for x86-64-v3 and would die of an illegal instruction. Compiled for plain
// x86-64 (see CMakeLists.txt).
#include <unistd.h>

#include <cstdlib>

namespace {

__attribute__((constructor(101))) void RefuseOldProcessor() {
  __builtin_cpu_init();
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") &&
      __builtin_cpu_supports("bmi2")) {
    return;
  }
  constexpr char kLine[] =
      "error: this processor lacks AVX2, FMA or BMI2 (x86-64-v3), which Tessera needs; "
      "use a machine of 2013 (Intel Haswell) or 2015 (AMD Excavator) or newer\n";
  if (write(STDERR_FILENO, kLine, sizeof(kLine) - 1) < 0) _exit(1);
  _exit(2);
}

}  // namespace
