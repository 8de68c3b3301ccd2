// Layers carry the planes that they are named after, cropped to the data window.
#include "core/image/layers.h"

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace tessera {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

TEST(ParseLayerList, KnowsAllLayersAndTheirOrder) {
  EXPECT_THAT(*ParseLayerList("all"), ElementsAre("final", "raw", "albedo", "normal", "Z", "id",
                                                  "samples", "variance", "error"));
  EXPECT_THAT(*ParseLayerList("Z,final,Z"), ElementsAre("final", "Z"));
}

TEST(ParseLayerList, NamesWhatIsUnknownAndWhatThereIs) {
  for (const char* list : {"depth", "", "final,", "final,depth"}) {
    const absl::Status status = ParseLayerList(list).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << list;
    EXPECT_THAT(std::string(status.message()), HasSubstr("raw, albedo, normal, Z")) << list;
  }
}

// The value of channel c of plane number `plane` at pixel i.
float Value(int plane, int c, int64_t i) { return static_cast<float>(plane * 1000 + c * 100 + i); }

TEST(AddPictureLayer, CropsEachPlane) {
  FramePlanes planes(PixelRect{1, 1, 5, 4});
  FilteredPlanes filtered(PixelRect{0, 0, 6, 6});
  for (int64_t i = 0; i < planes.bounds.area(); ++i) {
    for (int c = 0; c < 3; ++c) {
      planes.color[c][i] = Value(1, c, i);
      planes.albedo[c][i] = Value(2, c, i);
      planes.normal[c][i] = Value(3, c, i);
      planes.variance[c][i] = Value(4, c, i);
    }
    planes.depth[i] = Value(5, 0, i);
    planes.coverage[i] = 0.25f;
    planes.material_id[i] = static_cast<uint32_t>(i);
    planes.samples[i] = static_cast<uint32_t>(100 + i);
  }
  for (int64_t i = 0; i < filtered.bounds.area(); ++i) {
    for (int c = 0; c < 3; ++c) {
      filtered.color[c][i] = Value(6, c, i);
      filtered.error[c][i] = Value(7, c, i);
    }
  }
  Image image;
  image.data_window = {2, 2, 4, 4};
  for (const PictureLayer& layer : PictureLayers()) {
    AddPictureLayer(layer, planes, filtered, true, &image);
  }
  const int64_t in_planes = planes.bounds.IndexOf(3, 3);
  const int64_t in_filtered = filtered.bounds.IndexOf(3, 3);
  EXPECT_EQ(image.channels.size(), 4u + 3 + 3 + 3 + 1 + 1 + 1 + 3 + 3);
  EXPECT_EQ(image.Find("G")->floats[3], Value(6, 1, in_filtered));
  EXPECT_EQ(image.Find("A")->floats[3], 0.25f);
  EXPECT_EQ(image.Find("raw.B")->floats[3], Value(1, 2, in_planes));
  EXPECT_EQ(image.Find("albedo.R")->floats[3], Value(2, 0, in_planes));
  EXPECT_EQ(image.Find("normal.Z")->floats[3], Value(3, 2, in_planes));
  EXPECT_EQ(image.Find("Z")->floats[3], Value(5, 0, in_planes));
  EXPECT_EQ(image.Find("id")->uints[3], static_cast<uint32_t>(in_planes));
  EXPECT_EQ(image.Find("samples")->uints[3], static_cast<uint32_t>(100 + in_planes));
  EXPECT_EQ(image.Find("variance.R")->floats[3], Value(4, 0, in_planes));
  EXPECT_EQ(image.Find("error.G")->floats[3], Value(7, 1, in_filtered));
}

TEST(AddPictureLayer, OpaquePicturesHaveFullAlpha) {
  const FramePlanes planes(PixelRect{0, 0, 2, 1});
  const FilteredPlanes filtered(planes.bounds);
  Image image;
  image.data_window = planes.bounds;
  AddPictureLayer(*FindPictureLayer("final"), planes, filtered, false, &image);
  EXPECT_THAT(image.Find("A")->floats, ElementsAre(1.0f, 1.0f));
}

}  // namespace
}  // namespace tessera
