#include "worker/integrator/isa_class.h"

#include <algorithm>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "core/base/isa_level.h"
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

}  // namespace

std::vector<std::string> SupportedIsaClasses() {
  std::vector<std::string> names;
  for (const IsaClass& c : kClasses) {
    if (ProcessorRuns(c.name)) names.push_back(c.name);
  }
  return names;
}

absl::StatusOr<std::string> EmbreeIsaOf(const std::string& isa_class) {
  for (const IsaClass& c : kClasses) {
    if (isa_class != c.name) continue;
    if (ProcessorRuns(isa_class)) return std::string(c.embree);
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
