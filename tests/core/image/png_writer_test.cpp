// PNG files show the picture through exposure and the sRGB transfer.
#include "core/image/png_writer.h"

#include <cmath>

#include "core/image/image_reader.h"
#include "gtest/gtest.h"
#include "tests/core/image/image_fixture.h"

namespace tessera {
namespace {

using PngWriterTest = TempFolderTest;

TEST_F(PngWriterTest, PngRoundsTheSrgbTransferAndKeepsAlpha) {
  Image image;
  image.data_window = image.display_window = {0, 0, 4, 1};
  image.Add("R", std::vector<float>{0.0f, 0.5f, 2.0f, 0.25f});
  image.Add("G", std::vector<float>{-1.0f, 0.18f, std::nanf(""), 0.25f});
  image.Add("B", std::vector<float>{0.002f, 1.0f, 0.1f, 0.25f});
  image.Add("A", std::vector<float>{1.0f, 1.0f, 1.0f, 0.5f});
  ASSERT_TRUE(WritePng(Path("a.png"), image, {}).ok());
  const absl::StatusOr<Image> read = ReadImage(Path("a.png"));
  ASSERT_TRUE(read.ok()) << read.status();
  // 8-bit codes by the standard's formula; the last pixel is 0.25 / 0.5 before the transfer.
  const int codes[4][3] = {{0, 0, 7}, {188, 118, 255}, {255, 0, 89}, {188, 188, 188}};
  const float alphas[4] = {1, 1, 1, 128.0f / 255.0f};
  for (int i = 0; i < 4; ++i) {
    EXPECT_FLOAT_EQ(read->Find("A")->floats[i], alphas[i]);
    for (int c = 0; c < 3; ++c) {
      const float decoded = read->channels[c].floats[i] / alphas[i];
      EXPECT_NEAR(SrgbEncode(decoded) * 255, codes[i][c], 0.01) << i << " " << c;
    }
  }
}

TEST_F(PngWriterTest, PngExposureIsInStops) {
  Image image;
  image.data_window = image.display_window = {0, 0, 1, 1};
  for (const char* name : {"R", "G", "B"}) image.Add(name, std::vector<float>{0.125f});
  const absl::StatusOr<std::string> plain = EncodePng(image, {});
  const absl::StatusOr<std::string> brighter = EncodePng(image, {.exposure_ev = 2});
  for (ImageChannel& channel : image.channels) channel.floats[0] = 0.5f;
  const absl::StatusOr<std::string> expected = EncodePng(image, {});
  ASSERT_TRUE(plain.ok() && brighter.ok() && expected.ok());
  EXPECT_EQ(*brighter, *expected);
  EXPECT_NE(*plain, *expected);
}

}  // namespace
}  // namespace tessera
