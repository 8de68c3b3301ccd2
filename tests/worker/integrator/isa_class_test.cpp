#include "worker/integrator/isa_class.h"

#include <gtest/gtest.h>

#include "worker/integrator/path_tracer.h"

namespace tessera {
namespace {

TEST(IsaClassTest, SupportedClassesHaveAnEmbreeNameAndTheDefaultIsAmongThem) {
  const std::vector<std::string> classes = SupportedIsaClasses();
  bool has_default = false;
  for (const std::string& name : classes) {
    EXPECT_TRUE(EmbreeIsaOf(name).ok()) << name;
    has_default |= name == RenderSettings().isa;
  }
  EXPECT_TRUE(has_default);
  EXPECT_EQ(*EmbreeIsaOf("x86-64-v3"), "avx2");
}

TEST(IsaClassTest, UnknownClassesAreRefusedWithTheKnownOnes) {
  const auto isa = EmbreeIsaOf("avx2");
  EXPECT_EQ(isa.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_NE(isa.status().message().find("x86-64-v3"), std::string::npos);
}

}  // namespace
}  // namespace tessera
