// The raw mean and its interval.
#include "core/denoise/none_filter.h"

#include "core/denoise/confidence.h"
#include "gtest/gtest.h"

namespace tessera {
namespace {

TEST(NoneFilter, CopiesTheColorAndScalesTheVariance) {
  FramePlanes planes(PixelRect{0, 0, 2, 1});
  planes.samples = {4, 1};
  planes.color[1] = {0.5f, 0.25f};
  planes.variance[1] = {0.04f, kInfinity};
  FilteredPlanes out(planes.bounds);
  NoneFilter().Filter(planes, {planes.bounds}, planes.bounds, &out);
  EXPECT_EQ(out.color[1], planes.color[1]);
  EXPECT_NEAR(out.error[1][0], 1.96f * 0.2f, 1e-4f);
  EXPECT_EQ(out.error[1][1], kInfinity);
}

}  // namespace
}  // namespace tessera
