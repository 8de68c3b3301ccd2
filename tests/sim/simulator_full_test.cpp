// Many more seeds than every change is tried with: scripts/test --full.
#include <gtest/gtest.h>

#include "tests/sim/farm_simulation.h"

namespace tessera {
namespace {

class ManySchedules : public testing::TestWithParam<uint64_t> {};

TEST_P(ManySchedules, Hold) {
  for (uint64_t seed = 1000 * GetParam(); seed < 1000 * (GetParam() + 1); ++seed) {
    EXPECT_EQ(Simulate(MakeFaultPlan(seed)).violation, "")
        << "replay it: build/release/bin/simulate --seed " << seed << " --trace";
  }
}
INSTANTIATE_TEST_SUITE_P(Seeds, ManySchedules, testing::Range(uint64_t{0}, uint64_t{10}));

TEST(ManyLargeFarms, Hold) {
  for (uint64_t seed = 0; seed < 100; ++seed) {
    EXPECT_EQ(Simulate(MakeFaultPlan(seed, true)).violation, "")
        << "replay it: build/release/bin/simulate --seed " << seed << " --large --trace";
  }
}

}  // namespace
}  // namespace tessera
