#include "worker/integrator/isa_class.h"

#include <algorithm>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "worker/integrator/path_tracer.h"

namespace tessera {
namespace {

struct IsaClass {
  const char* name;
  const char* embree;
};

// Widest first.
constexpr IsaClass kClasses[] = {
    {"x86-64-v4", "avx512"}, {"x86-64-v3", "avx2"}, {"x86-64-v2", "sse4.2"}};

bool Runs(const std::string& name) {
  if (name == "x86-64-v4") {
    return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
           __builtin_cpu_supports("avx512cd") && __builtin_cpu_supports("avx512dq") &&
           __builtin_cpu_supports("avx512vl");
  }
  if (name == "x86-64-v3") {
    return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") &&
           __builtin_cpu_supports("bmi2");
  }
  return __builtin_cpu_supports("sse4.2") && __builtin_cpu_supports("popcnt");
}

}  // namespace

std::vector<std::string> SupportedIsaClasses() {
  std::vector<std::string> names;
  for (const IsaClass& c : kClasses) {
    if (Runs(c.name)) names.push_back(c.name);
  }
  return names;
}

absl::StatusOr<std::string> EmbreeIsaOf(const std::string& isa_class) {
  for (const IsaClass& c : kClasses) {
    if (isa_class != c.name) continue;
    if (Runs(isa_class)) return std::string(c.embree);
    return absl::FailedPreconditionError(absl::StrCat("this machine cannot run ISA class ",
                                                      isa_class, "; it runs ",
                                                      absl::StrJoin(SupportedIsaClasses(), ", ")));
  }
  std::vector<std::string> names;
  for (const IsaClass& c : kClasses) names.push_back(c.name);
  return absl::InvalidArgumentError(
      absl::StrCat("unknown ISA class '", isa_class, "'; known: ", absl::StrJoin(names, ", ")));
}

}  // namespace tessera
