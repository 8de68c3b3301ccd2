// Unreadable, truncated, damaged and oversized images: clear errors, no crash.
#include "core/image/image_reader.h"

#include <OpenImageIO/imageio.h>

#include <memory>
#include <random>

#include "absl/strings/str_cat.h"
#include "core/image/exr_writer.h"
#include "core/image/png_writer.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/core/image/image_fixture.h"

namespace tessera {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

using ImageReaderTest = TempFolderTest;

TEST_F(ImageReaderTest, UnreadableFilesAreNamedWithTheCause) {
  const auto message = [&](const std::string& path) {
    const absl::StatusOr<Image> image = ReadImage(path);
    EXPECT_FALSE(image.ok()) << path;
    EXPECT_THAT(std::string(image.status().message()), HasSubstr(path));
    return std::string(image.status().message());
  };
  EXPECT_THAT(message(Path("missing.exr")), HasSubstr("No such file"));
  EXPECT_THAT(message(folder_.string()), HasSubstr("not a regular file"));
  WriteBytes("empty.exr", "");
  EXPECT_THAT(message(Path("empty.exr")), HasSubstr("empty"));
  WriteBytes("text.png", "once upon a time, there was no image");
  EXPECT_THAT(message(Path("text.png")), HasSubstr("not an image"));
  WriteBytes("magic.exr", std::string("\x76\x2f\x31\x01", 4));
  EXPECT_THAT(message(Path("magic.exr")), HasSubstr("damaged"));
}

TEST_F(ImageReaderTest, TruncatedFilesAreRefusedAtEveryLength) {
  ASSERT_TRUE(WriteExr(Path("whole.exr"), MixedImage(40, 40)).ok());
  Image color = MixedImage(40, 40);
  ASSERT_TRUE(WritePng(Path("whole.png"), color, {}).ok());
  for (const std::string extension : {".exr", ".png"}) {
    const std::string bytes = ReadBytes(absl::StrCat("whole", extension));
    const std::string cut = absl::StrCat("cut", extension);
    for (int eighths = 1; eighths < 8; ++eighths) {
      WriteBytes(cut, bytes.substr(0, bytes.size() * eighths / 8));
      EXPECT_FALSE(ReadImage(Path(cut)).ok()) << extension << " " << eighths;
    }
  }
}

TEST_F(ImageReaderTest, DamagedFilesDoNotCrash) {
  ASSERT_TRUE(WriteExr(Path("whole.exr"), MixedImage(20, 20)).ok());
  const std::string bytes = ReadBytes("whole.exr");
  std::mt19937 random(7);
  for (int i = 0; i < 200; ++i) {
    std::string damaged = bytes;
    for (int k = 0; k < 4; ++k) {
      damaged[random() % (i % 2 == 0 ? damaged.size() : size_t{1200})] =
          static_cast<char>(random());
    }
    WriteBytes("damaged.exr", damaged);
    const absl::StatusOr<Image> image =
        ReadImage(Path("damaged.exr"), {.pixels_max = 1 << 16, .values_max = 1 << 20});
    if (!image.ok()) {
      EXPECT_THAT(std::string(image.status().message()), HasSubstr("damaged"));
    }
  }
}

// Half floats, as other renderers write them, beside integers.
TEST_F(ImageReaderTest, HalfFloatsBecomeFloats) {
  const OIIO::TypeDesc half(OIIO::TypeDesc::HALF), uint(OIIO::TypeDesc::UINT);
  const OIIO::TypeDesc native(OIIO::TypeDesc::UNKNOWN);
  OIIO::ImageSpec spec(2, 1, 2, half);
  spec.channelnames = {"R", "id"};
  spec.channelformats.push_back(half);
  spec.channelformats.push_back(uint);
  // 1.5 and the greatest half, 65504; then 7 and the greatest integer.
  const unsigned char pixels[] = {0x00, 0x3e, 7, 0, 0, 0, 0xff, 0x7b, 255, 255, 255, 255};
  const std::unique_ptr<OIIO::ImageOutput> output = OIIO::ImageOutput::create("openexr");
  ASSERT_TRUE(output->open(Path("half.exr"), spec));
  ASSERT_TRUE(output->write_image(native, pixels));
  ASSERT_TRUE(output->close());
  const absl::StatusOr<Image> image = ReadImage(Path("half.exr"));
  ASSERT_TRUE(image.ok()) << image.status();
  EXPECT_THAT(image->Find("R")->floats, ElementsAre(1.5f, 65504.0f));
  EXPECT_THAT(image->Find("id")->uints, ElementsAre(7u, 0xffffffffu));
}

TEST_F(ImageReaderTest, OneIntegerChannelComesAlone) {
  Image image = MixedImage(37, 150);
  image.metadata["digest"] = std::string("abc");
  ASSERT_TRUE(WriteExr(Path("mixed.exr"), image).ok());
  const ImageChannel* expected = nullptr;
  for (const ImageChannel& channel : image.channels) {
    if (channel.is_uint) expected = &channel;
  }
  ASSERT_NE(expected, nullptr);
  const absl::StatusOr<Image> read = ReadUintChannel(Path("mixed.exr"), expected->name);
  ASSERT_TRUE(read.ok()) << read.status();
  ASSERT_EQ(read->channels.size(), 1u);
  EXPECT_EQ(read->channels[0].uints, expected->uints);
  EXPECT_EQ(read->data_window, image.data_window);
  EXPECT_EQ(std::get<std::string>(read->metadata.at("digest")), "abc");
  for (const char* other : {"R", "none"}) {
    EXPECT_THAT(std::string(ReadUintChannel(Path("mixed.exr"), other).status().message()),
                HasSubstr(other));
  }
}

TEST_F(ImageReaderTest, SizeLimitsAreStated) {
  ASSERT_TRUE(WriteExr(Path("a.exr"), MixedImage(40, 40)).ok());
  const absl::StatusOr<Image> image = ReadImage(Path("a.exr"), {.pixels_max = 1599});
  ASSERT_EQ(image.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(image.status().message()), HasSubstr("40x40"));
  EXPECT_TRUE(ReadImage(Path("a.exr"), {.pixels_max = 1600}).ok());
}

}  // namespace
}  // namespace tessera
