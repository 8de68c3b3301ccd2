#include "worker/scene/image_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <zlib.h>

#include <cstdlib>

#include "tests/worker/scene/picture_bytes.h"
#include "tests/worker/scene/scene_file.h"

namespace tessera {
namespace {

using ::testing::HasSubstr;

int Expected(int x, int y, int c) { return (7 * x + 31 * y + 50 * c) % 256; }

TEST(ImageFile, PngOfAnyChannelCountBecomesRgba) {
  constexpr int kWidth = 5, kHeight = 3;
  for (int channels = 1; channels <= 4; ++channels) {
    const std::string file = PictureBytes("png", kWidth, kHeight, channels);
    const auto size = ReadImageSize(file);
    ASSERT_TRUE(size.ok()) << size.status();
    EXPECT_EQ(size->width, kWidth);
    EXPECT_EQ(size->height, kHeight);
    std::vector<uint8_t> rgba;
    ASSERT_TRUE(DecodeRgba8(file, &rgba).ok());
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const uint8_t* pixel = rgba.data() + 4 * (y * kWidth + x);
        for (int c = 0; c < 3; ++c) {
          EXPECT_EQ(pixel[c], Expected(x, y, channels >= 3 ? c : 0)) << channels;
        }
        // Alpha is stored as it is, and never multiplied into the colour.
        const int alpha = channels == 4   ? Expected(x, y, 3)
                          : channels == 2 ? Expected(x, y, 1)
                                          : 255;
        EXPECT_EQ(pixel[3], alpha) << channels;
      }
    }
  }
}

std::string BigEndian(uint32_t value) {
  std::string bytes;
  for (int shift = 24; shift >= 0; shift -= 8) bytes += static_cast<char>(value >> shift);
  return bytes;
}

std::string PngChunk(const std::string& typed) {
  const auto sum = crc32(0, reinterpret_cast<const Bytef*>(typed.data()),
                         static_cast<uInt>(typed.size()));
  return BigEndian(static_cast<uint32_t>(typed.size() - 4)) + typed +
         BigEndian(static_cast<uint32_t>(sum));
}

// Headers of 10^10 pixels: refused before anything is taken for them.
TEST(ImageFile, HugePicturesAreRefusedByTheirHeaders) {
  const std::string side = BigEndian(100000);
  const std::string png = "\x89PNG\r\n\x1a\n" +
                          PngChunk("IHDR" + side + side + std::string("\x08\x06\0\0\0", 5)) +
                          PngChunk("IDAT") + PngChunk("IEND");
  const absl::Status status = ReadImageSize(png).status();
  EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(status.message()), HasSubstr("100000"));
  std::vector<uint8_t> rgba;
  EXPECT_FALSE(DecodeRgba8(png, &rgba).ok());
  EXPECT_EQ(rgba.capacity(), 0u);
}

TEST(ImageFile, JpegAndWebp) {
  for (const char* format : {"jpg", "webp"}) {
    const std::string file = PictureBytes(format, 16, 16, 3, std::vector<float>(16 * 16 * 3, 0.5f));
    std::vector<uint8_t> rgba;
    const absl::Status status = DecodeRgba8(file, &rgba);
    ASSERT_TRUE(status.ok()) << status;
    ASSERT_EQ(rgba.size(), 16u * 16 * 4);
    for (size_t c = 0; c < 3; ++c) EXPECT_LE(std::abs(int{rgba[c]} - 128), 3) << format;
    EXPECT_EQ(rgba[3], 255);
  }
}

TEST(ImageFile, RadianceMaps) {
  for (const char* format : {"hdr", "exr"}) {
    const std::string file = PictureBytes(format, 2, 1, 3, {1, 2, 4, 100, 50, 25});
    std::vector<Imath::V3f> texels;
    const auto size = DecodeRadiance(file, &texels);
    ASSERT_TRUE(size.ok()) << size.status();
    ASSERT_EQ(size->width, 2);
    EXPECT_NEAR(texels[0].z, 4, 0.05);
    EXPECT_NEAR(texels[1].x, 100, 1);
  }
}

TEST(ImageFile, BrokenFiles) {
  const auto error_of = [](const std::string& file) {
    return std::string(ReadImageSize(file).status().message());
  };
  EXPECT_THAT(error_of(""), HasSubstr("empty"));
  EXPECT_THAT(error_of("GIF89a..."), HasSubstr("not a PNG, JPEG or WebP"));
  const std::string png = PictureBytes("png", 64, 64, 3);
  EXPECT_THAT(error_of(png.substr(0, 20)), HasSubstr("truncated"));
  EXPECT_THAT(error_of(png.substr(0, png.size() / 2)), HasSubstr("truncated"));
  std::string flipped = png;
  flipped[50] = static_cast<char>(flipped[50] ^ 1);
  EXPECT_THAT(error_of(flipped), HasSubstr("damaged (checksum)"));
  EXPECT_THAT(error_of(PictureBytes("jpg", 64, 64, 3).substr(0, 100)), HasSubstr("damaged"));
  EXPECT_THAT(error_of(PictureBytes("png", kImageSidePxMax + 1, 1, 1)), HasSubstr("not supported"));
}

SceneFile Textured() {
  SceneFile file = OneTriangle();
  file.json["materials"] = {{{"emissiveTexture", {{"index", 0}}}}};
  PrimitiveOf(file)["material"] = 0;
  file.json["images"] = {{{"uri", "a.png"}, {"name", "picture"}}};
  file.json["textures"] = {{{"source", 0}}};
  file.files["a.png"] = PictureBytes("png", 4, 2, 3);
  return file;
}

TEST(GltfImages, FilesViewsAndWebp) {
  const auto external = Textured().Load();
  ASSERT_TRUE(external.ok()) << external.status();
  EXPECT_EQ((*external)->textures[0].width, 4);
  EXPECT_EQ((*external)->textures[0].name, "picture");

  SceneFile embedded = Textured();
  const int view = embedded.AddView(PictureBytes("png", 8, 8, 4));
  embedded.json["images"] = {{{"bufferView", view}, {"mimeType", "image/png"}}};
  const auto scene = embedded.Load();
  ASSERT_TRUE(scene.ok()) << scene.status();
  EXPECT_EQ((*scene)->textures[0].rgba.size(), 8u * 8 * 4);

  SceneFile webp = Textured();
  webp.json["extensionsRequired"] = {"EXT_texture_webp"};
  webp.json["images"].push_back({{"uri", "a.webp"}});
  webp.json["textures"] = {{{"extensions", {{"EXT_texture_webp", {{"source", 1}}}}}}};
  webp.files["a.webp"] = PictureBytes("webp", 6, 2, 3);
  const auto webp_scene = webp.Load();
  ASSERT_TRUE(webp_scene.ok()) << webp_scene.status();
  EXPECT_EQ((*webp_scene)->textures[0].width, 6);
}

TEST(GltfImages, MissingAndBrokenImagesAreNamed) {
  SceneFile missing = Textured();
  missing.files.erase("a.png");
  EXPECT_EQ(missing.Load().status().code(), absl::StatusCode::kNotFound);
  EXPECT_THAT(missing.LoadError(), HasSubstr("images[0].uri: no file a.png"));
  SceneFile broken = Textured();
  broken.files["a.png"] = broken.files["a.png"].substr(0, 50);
  EXPECT_THAT(broken.LoadError(), HasSubstr("images[0]: the image is truncated"));
  SceneFile limited = Textured();
  limited.files["a.png"] = PictureBytes("png", 2048, 2048, 1);
  limited.request.memory_max_bytes = 1 << 20;
  EXPECT_EQ(limited.Load().status().code(), absl::StatusCode::kResourceExhausted);
}

}  // namespace
}  // namespace tessera
