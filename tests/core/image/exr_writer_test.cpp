// EXR files give back every bit that was written.
#include "core/image/exr_writer.h"

#include <cstring>
#include <limits>
#include <utility>

#include "core/image/image_reader.h"
#include "gtest/gtest.h"
#include "tests/core/image/image_fixture.h"

namespace tessera {
namespace {

using ExrWriterTest = TempFolderTest;

void ExpectSameChannels(const Image& expected, const Image& read) {
  ASSERT_EQ(read.channels.size(), expected.channels.size());
  for (const ImageChannel& channel : expected.channels) {
    const ImageChannel* other = read.Find(channel.name);
    ASSERT_NE(other, nullptr) << channel.name;
    ASSERT_EQ(other->is_uint, channel.is_uint) << channel.name;
    EXPECT_EQ(other->uints, channel.uints) << channel.name;
    ASSERT_EQ(other->floats.size(), channel.floats.size());
    if (channel.is_uint) continue;
    const size_t num_bytes = channel.floats.size() * sizeof(float);
    EXPECT_EQ(std::memcmp(other->floats.data(), channel.floats.data(), num_bytes), 0)
        << channel.name;
  }
}

TEST_F(ExrWriterTest, ExrKeepsEveryBitOfFloatsAndIntegers) {
  for (const auto& [width, height] : {std::pair{1, 1}, {7, 3}, {1, 200}, {131, 67}}) {
    const Image image = MixedImage(width, height);
    ASSERT_TRUE(WriteExr(Path("a.exr"), image).ok());
    const absl::StatusOr<Image> read = ReadImage(Path("a.exr"));
    ASSERT_TRUE(read.ok()) << read.status();
    EXPECT_EQ(read->data_window, image.data_window);
    EXPECT_EQ(read->display_window, image.display_window);
    EXPECT_EQ(read->metadata, image.metadata);
    ExpectSameChannels(image, *read);
  }
  EXPECT_EQ(NumFiles(), 1u);
}

TEST_F(ExrWriterTest, MetadataOfSixtyFourBitsSurvivesAsText) {
  Image image = MixedImage(4, 4);
  image.metadata["seed"] = std::numeric_limits<int64_t>::max();
  ASSERT_TRUE(WriteExr(Path("a.exr"), image).ok());
  const absl::StatusOr<Image> read = ReadImage(Path("a.exr"));
  ASSERT_TRUE(read.ok());
  EXPECT_EQ(std::get<std::string>(read->metadata.at("seed")), "9223372036854775807");
}

}  // namespace
}  // namespace tessera
