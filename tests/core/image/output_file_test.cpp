// Files appear whole or not at all; unwritable places give clear errors.
#include "core/image/output_file.h"

#include <sys/resource.h>
#include <unistd.h>

#include <csignal>
#include <filesystem>

#include "core/image/exr_writer.h"
#include "core/image/image_reader.h"
#include "core/image/png_writer.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/core/image/image_fixture.h"

namespace tessera {
namespace {

using ::testing::HasSubstr;

using OutputFileTest = TempFolderTest;

TEST_F(OutputFileTest, UnwritablePlacesAreNamedAndLeaveNothing) {
  const Image image = MixedImage(8, 8);
  const absl::Status no_folder = WriteExr(Path("none/a.exr"), image);
  EXPECT_EQ(no_folder.code(), absl::StatusCode::kNotFound);
  EXPECT_THAT(std::string(no_folder.message()), HasSubstr(Path("none/a.exr")));
  std::filesystem::create_directory(Path("folder.exr"));
  EXPECT_THAT(std::string(WriteExr(Path("folder.exr"), image).message()),
              HasSubstr("Is a directory"));
  EXPECT_THAT(std::string(WritePng("/dev/null", image, {}).message()),
              HasSubstr("not a regular file"));
  EXPECT_FALSE(WriteExr("", image).ok());
  EXPECT_EQ(NumFiles(), 1u);
}

TEST_F(OutputFileTest, AFullDiskIsAnErrorAndKeepsTheOldFile) {
  WriteBytes("a.exr", "old");
  const Image image = MixedImage(300, 300);
  rlimit old_limit;
  getrlimit(RLIMIT_FSIZE, &old_limit);
  const auto old_handler = std::signal(SIGXFSZ, SIG_IGN);
  const rlimit limit = {1000, old_limit.rlim_max};
  setrlimit(RLIMIT_FSIZE, &limit);
  const absl::Status exr = WriteExr(Path("a.exr"), image);
  const absl::Status png = WritePng(Path("b.png"), image, {});
  setrlimit(RLIMIT_FSIZE, &old_limit);
  std::signal(SIGXFSZ, old_handler);
  EXPECT_EQ(exr.code(), absl::StatusCode::kResourceExhausted) << exr;
  EXPECT_EQ(png.code(), absl::StatusCode::kResourceExhausted) << png;
  EXPECT_EQ(ReadBytes("a.exr"), "old");
  EXPECT_EQ(NumFiles(), 1u);
}

TEST_F(OutputFileTest, WritingThroughALinkKeepsTheLink) {
  WriteBytes("real.exr", "old");
  std::filesystem::create_symlink("real.exr", Path("link.exr"));
  ASSERT_TRUE(WriteExr(Path("link.exr"), MixedImage(3, 3)).ok());
  EXPECT_TRUE(std::filesystem::is_symlink(Path("link.exr")));
  EXPECT_TRUE(ReadImage(Path("real.exr")).ok());
}

}  // namespace
}  // namespace tessera
