// The bytes of a file decide its format; attributes come back as metadata.
#include "core/image/image_input.h"

#include "core/image/exr_writer.h"
#include "core/image/png_writer.h"
#include "gtest/gtest.h"
#include "tests/core/image/image_fixture.h"

namespace tessera {
namespace {

using ImageInputTest = TempFolderTest;

TEST_F(ImageInputTest, TheBytesDecideTheFormat) {
  const Image image = MixedImage(5, 4);
  ASSERT_TRUE(WriteExr(Path("really-exr.png"), image).ok());
  ASSERT_TRUE(WritePng(Path("really-png.exr"), image, {}).ok());
  WriteBytes("tiny.txt",
             std::string("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 1\n") + "\x80\x40\x20\x81");
  EXPECT_EQ(OpenImage(Path("really-exr.png"), {})->format, "openexr");
  EXPECT_EQ(OpenImage(Path("really-png.exr"), {})->format, "png");
  EXPECT_EQ(OpenImage(Path("tiny.txt"), {})->format, "hdr");
  // RGBE: mantissa / 256 * 2^(exponent - 128).
  const absl::StatusOr<Image> hdr = ReadImage(Path("tiny.txt"));
  ASSERT_TRUE(hdr.ok()) << hdr.status();
  EXPECT_NEAR(hdr->Find("R")->floats[0], 1.0f, 0.01f);
  EXPECT_NEAR(hdr->Find("G")->floats[0], 0.5f, 0.01f);
  EXPECT_NEAR(hdr->Find("B")->floats[0], 0.25f, 0.01f);
}

TEST_F(ImageInputTest, OtherAttributesAreNotMetadata) {
  ASSERT_TRUE(WriteExr(Path("a.exr"), MixedImage(5, 4)).ok());
  const absl::StatusOr<OpenedImage> opened = OpenImage(Path("a.exr"), {});
  ASSERT_TRUE(opened.ok());
  EXPECT_EQ(ReadMetadata(opened->input->spec()).size(), 3u);
  EXPECT_EQ(DataWindow(opened->input->spec()), PixelRect::FromSize(3, 5, 5, 4));
}

}  // namespace
}  // namespace tessera
