// Error measures on pictures small enough to compute by hand.
#include "core/image/compare.h"

#include <cmath>
#include <limits>

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace tessera {
namespace {

using ::testing::HasSubstr;

Image Grey(int width, int height, float value) {
  Image image;
  image.data_window = image.display_window = {0, 0, width, height};
  for (const char* name : {"R", "G", "B"}) {
    image.Add(name, std::vector<float>(static_cast<size_t>(width * height), value));
  }
  return image;
}

ImageErrors Compare(const Image& test, const Image& reference, const Image* second = nullptr) {
  const absl::StatusOr<ImageErrors> errors =
      CompareImages({"test", &test}, {"reference", &reference}, {"second", second});
  EXPECT_TRUE(errors.ok()) << errors.status();
  return errors.ok() ? *errors : ImageErrors();
}

TEST(CompareImages, EqualPictures) {
  const ImageErrors errors = Compare(Grey(20, 10, 0.3f), Grey(20, 10, 0.3f));
  EXPECT_EQ(errors.rel_mse, 0);
  EXPECT_EQ(errors.rel_mse_trimmed, 0);
  EXPECT_EQ(errors.psnr_db, std::numeric_limits<double>::infinity());
  EXPECT_NEAR(errors.ssim, 1, 1e-12);
  EXPECT_EQ(errors.flip, 0);
}

TEST(CompareImages, ConstantDifference) {
  const ImageErrors errors = Compare(Grey(20, 10, 0.6f), Grey(20, 10, 0.5f));
  EXPECT_NEAR(errors.rel_mse, 0.01 / 0.26, 1e-6);
  // sRGB of 0.6 and 0.5: 0.79774 and 0.73536.
  EXPECT_NEAR(errors.psnr_db, -20 * std::log10(0.79774 - 0.73536), 2e-3);
  EXPECT_NEAR(errors.ssim,
              (2 * 0.79774 * 0.73536 + 1e-4) / (0.79774 * 0.79774 + 0.73536 * 0.73536 + 1e-4),
              1e-5);
}

TEST(CompareImages, TheWorstThousandthOfThePixelsIsTrimmed) {
  Image test = Grey(100, 20, 0.6f);
  for (int c = 0; c < 3; ++c) test.channels[c].floats[77] = test.channels[c].floats[5] = 100;
  const ImageErrors errors = Compare(test, Grey(100, 20, 0.5f));
  EXPECT_NEAR(errors.rel_mse_trimmed, 0.01 / 0.26, 1e-6);
  EXPECT_NEAR(errors.rel_mse, (1998 * 0.01 + 2 * 99.5 * 99.5) / 0.26 / 2000, 1e-2);
}

TEST(CompareImages, TwoReferencesCancelTheirNoise) {
  // References 0.5 +- 0.1 around the truth 0.5; the picture is the truth.
  const Image first = Grey(4, 4, 0.6f), second = Grey(4, 4, 0.4f);
  EXPECT_NEAR(Compare(Grey(4, 4, 0.5f), first, &second).rel_mse, -0.01 / 0.26, 1e-6);
  EXPECT_NEAR(Compare(Grey(4, 4, 0.5f), second, &second).rel_mse, 0.01 / 0.17, 1e-6);
  EXPECT_EQ(Compare(Grey(4, 4, 0.5f), first, &second).psnr_db > 100, true);
}

TEST(CompareImages, ExposureActsOnWhatTheScreenShows) {
  const Image test = Grey(4, 4, 0.125f), reference = Grey(4, 4, 0.0625f);
  const absl::StatusOr<ImageErrors> brighter =
      CompareImages({"test", &test}, {"reference", &reference}, {}, {.exposure_ev = 3});
  ASSERT_TRUE(brighter.ok());
  EXPECT_NEAR(brighter->psnr_db, -20 * std::log10(1 - 0.73536), 1e-3);
  EXPECT_NEAR(brighter->rel_mse, Compare(test, reference).rel_mse, 1e-12);
}

TEST(CompareImages, WhatCannotBeComparedIsNamed) {
  const Image image = Grey(4, 4, 0.5f);
  const auto message = [&](const Image& other) {
    const absl::Status status = CompareImages({"a.exr", &image}, {"b.exr", &other}).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
    return std::string(status.message());
  };
  EXPECT_THAT(message(Grey(4, 5, 0.5f)), HasSubstr("a.exr has 4x4 pixels, b.exr has 4x5"));
  Image no_green = image;
  no_green.channels[1].name = "Y";
  EXPECT_THAT(message(no_green), HasSubstr("b.exr: no colour channel G"));
  Image not_finite = image;
  not_finite.channels[2].floats[3] = std::nanf("");
  EXPECT_THAT(message(not_finite), HasSubstr("b.exr: channel B holds values that are not finite"));
}

}  // namespace
}  // namespace tessera
