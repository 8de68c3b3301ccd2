// A film that is written and read is the same film, bit for bit; other files are refused.
#include "core/image/film_file.h"

#include <algorithm>
#include <random>

#include "core/base/tile_grid.h"
#include "core/image/exr_writer.h"
#include "core/image/image_reader.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/core/image/image_fixture.h"

namespace tessera {
namespace {

using ::testing::HasSubstr;
using FilmFileTest = TempFolderTest;

// Values that statistics may have, of every magnitude.
TileStatistics RandomNode(const PixelRect& window, SampleRange range, std::mt19937* random,
                          int64_t feature_end = kAllFeatures) {
  TileStatistics node(window, range, feature_end);
  std::uniform_real_distribution<float> exponent(-120, 50);
  for (int half = 0; half < kNumHalves; ++half) {
    const uint32_t count = static_cast<uint32_t>(node.FeatureHalfCount(half));
    const uint32_t later_count = static_cast<uint32_t>(node.HalfCount(half)) - count;
    for (uint32_t& hits : node.MutableCounts(half, kLaterHits))
      hits = (*random)() % (later_count + 1);
    const int num_planes = count > 0 ? kNumFloatPlanes : later_count > 0 ? kNumRadiancePlanes : 0;
    for (int plane = 0; plane < num_planes; ++plane) {
      const bool is_msd = plane == kDepthMsd || (plane < kDepthMean && plane % 6 >= 3);
      const uint32_t of_plane = plane < kNumRadiancePlanes ? count + later_count : count;
      if (is_msd && of_plane < 2) continue;  // a sample has no deviation
      for (float& value : node.MutableFloats(half, plane)) value = std::exp2(exponent(*random));
    }
    if (count == 0) continue;
    for (float& value : node.MutableFloats(half, kNormalMean)) value = -value;
    for (uint32_t& hits : node.MutableCounts(half, kHits)) hits = 1 + (*random)() % count;
    for (uint32_t& id : node.MutableCounts(half, kMaterialId))
      id = static_cast<uint32_t>((*random)());
    for (uint32_t& votes : node.MutableCounts(half, kIdVotes)) votes = (*random)() % (count + 1);
  }
  node.non_finite = (*random)() % (node.num_pixels() * range.size() + 1);
  return node;
}

// A render that was interrupted: tiles hold different ranges, some hold nothing.
FilmFile InterruptedFilm(const PixelRect& region, int tile_size, uint32_t seed,
                         int64_t feature_end = kAllFeatures) {
  std::mt19937 random(seed);
  FilmFile film;
  film.feature_end = feature_end;
  film.settings = "{\"spp\": 64, \"name\": \"caf\xc3\xa9\",\n \"empty\": \"\"}";
  film.region = region;
  film.frame = region.Expand(4);
  const std::vector<SampleRange> ranges[] = {
      {{0, 16}}, {{0, 16}, {16, 24}}, {{0, 1}}, {}, {{0, 8}, {12, 16}}};
  const TileGrid grid(region, tile_size);
  for (int64_t tile = 0; tile < grid.num_tiles(); ++tile) {
    for (const SampleRange& range : ranges[tile % std::size(ranges)]) {
      film.nodes.push_back(RandomNode(grid.WindowOf(tile), range, &random, feature_end));
    }
  }
  std::ranges::stable_sort(film.nodes, {}, &TileStatistics::range);
  return film;
}

Image PictureOf(const FilmFile& film) {
  Image picture;
  picture.data_window = film.region;
  picture.display_window = film.frame;
  const size_t area = static_cast<size_t>(film.region.area());
  for (const char* name : {"R", "G", "B", "A"}) picture.Add(name, RandomFloats(area, 3));
  picture.Add("samples", RandomUints(area, 4));
  picture.metadata["seed"] = int64_t{5};
  return picture;
}

TEST_F(FilmFileTest, EveryBitOfEveryNodeComesBack) {
  const std::pair<PixelRect, int> shapes[] = {
      {{0, 0, 1, 1}, 16}, {{5, 7, 42, 30}, 8}, {{0, 3, 3, 140}, 16}, {{-4, -2, 9, 9}, 1}};
  for (const int64_t feature_end : {int64_t{1}, int64_t{4}, int64_t{16}, kAllFeatures})
    for (const auto& [region, tile_size] : shapes) {
      const FilmFile film = InterruptedFilm(region, tile_size, 11, feature_end);
      const Image picture = PictureOf(film);
      ASSERT_TRUE(WriteFilmFile(Path("film.exr"), film, picture).ok());
      const absl::StatusOr<FilmFile> read = ReadFilmFile(Path("film.exr"));
      ASSERT_TRUE(read.ok()) << read.status();
      EXPECT_EQ(read->settings, film.settings);
      EXPECT_EQ(read->region, film.region);
      EXPECT_EQ(read->frame, film.frame);
      EXPECT_EQ(read->feature_end, feature_end);
      ASSERT_EQ(read->nodes.size(), film.nodes.size());
      EXPECT_TRUE(read->nodes == film.nodes);
    }
}

TEST_F(FilmFileTest, ThePictureIsInTheSameFile) {
  const FilmFile film = InterruptedFilm({0, 0, 20, 10}, 8, 1);
  const Image picture = PictureOf(film);
  ASSERT_TRUE(WriteFilmFile(Path("film.exr"), film, picture).ok());
  const absl::StatusOr<Image> read = ReadImage(Path("film.exr"));
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_EQ(read->Find("G")->floats, picture.Find("G")->floats);
  EXPECT_EQ(read->Find("samples")->uints, picture.Find("samples")->uints);
  EXPECT_EQ(std::get<int64_t>(read->metadata.at("seed")), 5);
}

TEST_F(FilmFileTest, AnEmptyFilmIsAFilm) {
  FilmFile film;
  film.region = film.frame = {0, 0, 4, 4};
  ASSERT_TRUE(WriteFilmFile(Path("film.exr"), film, PictureOf(film)).ok());
  const absl::StatusOr<FilmFile> read = ReadFilmFile(Path("film.exr"));
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_TRUE(read->nodes.empty());
}

TEST_F(FilmFileTest, NodesThatDoNotFitAreRefused) {
  FilmFile film = InterruptedFilm({0, 0, 20, 10}, 8, 1);
  const Image picture = PictureOf(film);
  std::mt19937 random(2);
  film.nodes.push_back(RandomNode({4, 4, 9, 9}, {0, 16}, &random));
  EXPECT_THAT(std::string(WriteFilmFile(Path("film.exr"), film, picture).message()),
              HasSubstr("overlap"));
  film.nodes.back() = RandomNode({18, 4, 21, 9}, {64, 128}, &random);
  EXPECT_THAT(std::string(WriteFilmFile(Path("film.exr"), film, picture).message()),
              HasSubstr("outside"));
  film.nodes.back() = RandomNode({16, 8, 20, 10}, {64, 128}, &random, 16);
  EXPECT_THAT(std::string(WriteFilmFile(Path("film.exr"), film, picture).message()),
              HasSubstr("features of other samples"));
  EXPECT_EQ(NumFiles(), 0u);
}

TEST_F(FilmFileTest, RangesThatAreNoNodesAreRefused) {
  FilmFile film;
  film.region = film.frame = {0, 0, 4, 4};
  std::mt19937 random(3);
  film.nodes.push_back(RandomNode(film.region, {0, 3}, &random));
  const Image picture = PictureOf(film);
  ASSERT_TRUE(WriteFilmFile(Path("film.exr"), film, picture).ok());
  EXPECT_EQ(ReadFilmFile(Path("film.exr")).status().code(), absl::StatusCode::kInvalidArgument);
}

TEST_F(FilmFileTest, ImagesWithoutAFilmSayHowToMakeOne) {
  ASSERT_TRUE(WriteExr(Path("plain.exr"), MixedImage(4, 4)).ok());
  const absl::Status status = ReadFilmFile(Path("plain.exr")).status();
  EXPECT_EQ(status.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(status.message()), HasSubstr("--layers film"));
  EXPECT_EQ(ReadFilmFile(Path("missing.exr")).status().code(), absl::StatusCode::kNotFound);
}

// A pixel may belong to a node of every range: what they would take is counted before it is taken.
TEST_F(FilmFileTest, MemoryIsCountedBeforeItIsTaken) {
  const FilmFile film = InterruptedFilm({0, 0, 64, 64}, 1, 11);
  ASSERT_TRUE(WriteFilmFile(Path("film.exr"), film, PictureOf(film)).ok());
  ASSERT_TRUE(ReadFilmFile(Path("film.exr"), {.bytes_max = int64_t{64} << 20}).ok());
  for (const int64_t bytes_max : {int64_t{1} << 16, int64_t{2} << 20}) {
    const absl::Status status =
        ReadFilmFile(Path("film.exr"), {.bytes_max = bytes_max}).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << bytes_max;
    EXPECT_THAT(std::string(status.message()), HasSubstr("the film needs more than the"));
  }
}

TEST_F(FilmFileTest, InconsistentFilmsAreRefused) {
  const FilmFile film = InterruptedFilm({0, 0, 20, 10}, 8, 1);
  ASSERT_TRUE(WriteFilmFile(Path("film.exr"), film, PictureOf(film)).ok());
  const absl::StatusOr<Image> read = ReadImage(Path("film.exr"));
  ASSERT_TRUE(read.ok());
  const auto refused_with = [&](const std::string& channel, const auto& change) {
    Image image = *read;
    for (ImageChannel& c : image.channels) {
      if (c.name == channel) change(&c);
    }
    EXPECT_TRUE(WriteExr(Path("changed.exr"), image).ok());
    const absl::Status status = ReadFilmFile(Path("changed.exr")).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << channel << status;
  };
  refused_with("film.0-16.node", [](ImageChannel* c) { c->uints[0] = 2; });
  refused_with("film.0-16.node", [](ImageChannel* c) { c->uints[0] = 0; });
  refused_with("film.0-16.node", [](ImageChannel* c) { c->uints[0] = 0xffffffffu; });
  refused_with("film.0-16.node", [](ImageChannel* c) { c->name = "film.5-2.node"; });
  refused_with("film.0-16.A.hits", [](ImageChannel* c) { c->name = "film.0-16.A.hit"; });
  refused_with("film.0-16.A.hits", [](ImageChannel* c) { c->uints[0] = 9; });
  refused_with("film.0-16.A.radiance.msd.R", [](ImageChannel* c) { c->floats[0] = -1; });
  refused_with("film.0-16.B.albedo.mean.G", [](ImageChannel* c) { c->floats[0] = NAN; });
  for (const MetadataValue& feature_spp :
       {MetadataValue(int64_t{12}), MetadataValue(int64_t{-1}), MetadataValue("many")}) {
    Image image = *read;
    image.metadata["film.feature_spp"] = feature_spp;
    ASSERT_TRUE(WriteExr(Path("changed.exr"), image).ok());
    EXPECT_EQ(ReadFilmFile(Path("changed.exr")).status().code(),
              absl::StatusCode::kInvalidArgument);
  }
}

}  // namespace
}  // namespace tessera
