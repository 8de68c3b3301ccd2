#include "worker/integrator/arithmetic.h"

#include <gtest/gtest.h>

#include <cmath>

#include "core/base/isa_classes.h"
#include "core/base/isa_level.h"
#include "worker/integrator/path_tracer.h"

namespace tessera {
namespace {

TEST(ArithmeticTest, EveryClassOfThisMachineHasAStableFingerprint) {
  for (const std::string& isa : SupportedIsaClasses()) {
    EXPECT_TRUE(IsArithmetic(ArithmeticOf(isa))) << isa;
    EXPECT_EQ(ComputeArithmetic(isa), ArithmeticOf(isa)) << isa;
  }
  // The same approximations divide in both; wider code has its own.
  EXPECT_EQ(ArithmeticOf("x86-64-v2"), ArithmeticOf("x86-64-v3"));
  if (ProcessorRuns("x86-64-v4")) {
    EXPECT_NE(ArithmeticOf("x86-64-v4"), ArithmeticOf("x86-64-v3"));
  }
}

// The table of sRGB is filled in double and rounded to float. No entry lies within two units of a
// double's last place of the middle between two floats, so that no sound math library, whatever its
// last bits, can fill it otherwise.
TEST(ArithmeticTest, TheTableOfColoursDoesNotHangOnLastBits) {
  for (int i = 11; i < 256; ++i) {  // the others take one division
    const double exact = std::pow((i / 255.0 + 0.055) / 1.055, 2.4);
    const double step = exact * 0x1p-51;
    EXPECT_EQ(static_cast<float>(exact - step), static_cast<float>(exact + step)) << i;
  }
}

}  // namespace
}  // namespace tessera
