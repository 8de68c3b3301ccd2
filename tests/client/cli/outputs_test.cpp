#include "client/cli/outputs.h"

#include <filesystem>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/image/image_reader.h"
#include "tests/client/fake_farm.h"
#include "tests/client/temporary_folder.h"

namespace tessera {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

std::string ErrorOf(const OutputFlags& flags) {
  const auto plan = PlanOutputs(flags);
  EXPECT_FALSE(plan.ok());
  return std::string(plan.status().message());
}

TEST(PlanOutputs, FormatsByEndingAndNothingIsLeftBehind) {
  const TemporaryFolder folder;
  const auto plan = PlanOutputs({{folder.Path("a.EXR"), folder.Path("b.png")}, "", "1.5"});
  ASSERT_TRUE(plan.ok()) << plan.status();
  EXPECT_EQ(plan->targets[0].format, OutputFormat::kExr);
  EXPECT_EQ(plan->targets[1].format, OutputFormat::kPng);
  EXPECT_EQ(plan->display.exposure_ev, 1.5f);
  EXPECT_TRUE(std::filesystem::is_empty(folder.Path(".")));
  EXPECT_EQ(FilmPathBeside(*plan), folder.Path("a.film.exr"));
}

TEST(PlanOutputs, AnExistingFileIsLeftAsItIs) {
  const TemporaryFolder folder;
  const std::string path = folder.Write("a.png", "precious");
  ASSERT_TRUE(PlanOutputs({{path}, "", ""}).ok());
  EXPECT_EQ(std::filesystem::file_size(path), 8u);
}

TEST(PlanOutputs, BadOutputsNameFileAndRemedy) {
  const TemporaryFolder folder;
  EXPECT_THAT(ErrorOf({{}, "", ""}), HasSubstr("-o"));
  EXPECT_THAT(ErrorOf({{folder.Path("a.jpg")}, "", ""}), HasSubstr(".exr or .png"));
  EXPECT_THAT(ErrorOf({{folder.Path("no/such/a.png")}, "", ""}), HasSubstr("no/such"));
  EXPECT_THAT(ErrorOf({{folder.Path("a.png"), folder.Path("a.png")}, "", ""}), HasSubstr("twice"));
  EXPECT_THAT(ErrorOf({{folder.Path("a.exr")}, "raw,sparkle", ""}), HasSubstr("sparkle"));
  EXPECT_THAT(ErrorOf({{folder.Path("a.png")}, "raw", ""}), HasSubstr("--layers"));
  EXPECT_THAT(ErrorOf({{folder.Path("a.png")}, "", "bright"}), HasSubstr("--exposure bright"));
  std::filesystem::create_directory(folder.Path("dir.png"));
  EXPECT_THAT(ErrorOf({{folder.Path("dir.png")}, "", ""}), HasSubstr("dir.png"));
}

TEST(PlanOutputs, Layers) {
  const TemporaryFolder folder;
  EXPECT_THAT(PlanOutputs({{folder.Path("a.exr")}, "Z,raw", ""})->layers, ElementsAre("raw", "Z"));
  EXPECT_EQ(PlanOutputs({{folder.Path("a.exr")}, "", ""})->layers.size(), 9u);
  const auto film = PlanOutputs({{folder.Path("a.exr")}, "film", ""});
  EXPECT_TRUE(film->film);
  EXPECT_EQ(film->layers.size(), 9u);
}

TEST(FetchAndWrite, PictureAndMetadata) {
  const TemporaryFolder folder;
  FakeFarm farm;
  farm.images.image = [](const v1::GetImageRequest& request,
                         grpc::ServerWriter<v1::GetImageResponse>* writer) {
    EXPECT_THAT(request.layers(), ElementsAre("final"));
    v1::GetImageResponse response;
    response.mutable_header()->mutable_region()->set_width(1);
    response.mutable_header()->mutable_region()->set_height(1);
    response.mutable_header()->set_frame_width(1);
    response.mutable_header()->set_frame_height(1);
    v1::ImageLayer* layer = response.mutable_header()->add_layers();
    layer->set_name("final");
    for (const char* channel : {"R", "G", "B", "A"}) layer->add_channels(channel);
    response.set_chunk(std::string(16, '\0'));
    writer->Write(response);
    return grpc::Status::OK;
  };
  v1::Job job;
  job.set_name("jobs/1");
  job.mutable_settings()->set_seed(UINT64_MAX);
  job.set_digest(std::string(32, '\x5a'));
  const auto plan = PlanOutputs({{folder.Path("a.exr"), folder.Path("a.png")}, "final", ""});
  ASSERT_TRUE(plan.ok());
  FarmClient client(farm.channel(), {});
  const auto paths = FetchAndWrite(client, job, *plan, PixelRect(), true);
  ASSERT_TRUE(paths.ok()) << paths.status();
  EXPECT_THAT(*paths, ElementsAre(folder.Path("a.exr"), folder.Path("a.png")));
  EXPECT_TRUE(std::filesystem::exists(folder.Path("a.png")));
  const auto image = ReadImage(folder.Path("a.exr"));
  ASSERT_TRUE(image.ok()) << image.status();
  EXPECT_EQ(std::get<std::string>(image->metadata.at("seed")), "18446744073709551615");
  EXPECT_THAT(std::get<std::string>(image->metadata.at("digest")), HasSubstr("5a5a5a"));
}

}  // namespace
}  // namespace tessera
