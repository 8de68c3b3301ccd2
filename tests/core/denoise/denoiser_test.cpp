// The list of filters.
#include "core/denoise/denoiser.h"

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace tessera {
namespace {

using ::testing::HasSubstr;

TEST(MakeDenoiser, MakesEachByItsName) {
  EXPECT_EQ(DenoiserNames().front(), "regression");
  for (const std::string& name : DenoiserNames()) {
    const auto denoiser = MakeDenoiser(name);
    ASSERT_TRUE(denoiser.ok()) << name;
    EXPECT_EQ((*denoiser)->name(), name);
  }
}

TEST(MakeDenoiser, ListsTheNamesWhenAskedForAnother) {
  const absl::Status status = MakeDenoiser("optix").status();
  EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(status.message()), HasSubstr("bilateral, nlm, welch, geometric, none"));
}

}  // namespace
}  // namespace tessera
