// What the tests of image files share: a folder of their own, and pictures with awkward values.
#pragma once

#include <stdlib.h>

#include <bit>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "core/image/image.h"
#include "gtest/gtest.h"

namespace tessera {

// A folder of its own for each test, removed with what is in it.
class TempFolderTest : public ::testing::Test {
 protected:
  TempFolderTest() {
    std::string pattern = (std::filesystem::temp_directory_path() / "tessera-XXXXXX").string();
    folder_ = mkdtemp(pattern.data());
  }
  ~TempFolderTest() override { std::filesystem::remove_all(folder_); }

  std::string Path(const std::string& name) const { return (folder_ / name).string(); }
  void WriteBytes(const std::string& name, const std::string& bytes) const {
    std::ofstream(Path(name), std::ios::binary) << bytes;
  }
  std::string ReadBytes(const std::string& name) const {
    std::ifstream file(Path(name), std::ios::binary);
    return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
  }
  size_t NumFiles() const {
    return static_cast<size_t>(std::distance(std::filesystem::directory_iterator(folder_), {}));
  }

  std::filesystem::path folder_;
};

// Every bit pattern that a float may have, and random ones.
inline std::vector<float> RandomFloats(size_t size, uint32_t seed) {
  std::mt19937 random(seed);
  std::vector<float> values = {0.0f, -0.0f, 1e-45f, std::numeric_limits<float>::max(),
                               std::numeric_limits<float>::infinity()};
  while (values.size() < size) {
    const float value = std::bit_cast<float>(static_cast<uint32_t>(random()));
    values.push_back(std::isnan(value) ? 0.5f : value);
  }
  values.resize(size);
  return values;
}

inline std::vector<uint32_t> RandomUints(size_t size, uint32_t seed) {
  std::mt19937 random(seed);
  std::vector<uint32_t> values = {0, 1, 16777217, 0xffffffffu};
  while (values.size() < size) values.push_back(static_cast<uint32_t>(random()));
  values.resize(size);
  return values;
}

// A picture of float and integer channels whose data window lies inside its display window.
inline Image MixedImage(int width, int height) {
  Image image;
  image.data_window = PixelRect::FromSize(3, 5, width, height);
  image.display_window = {0, 0, width + 10, height + 20};
  const size_t area = static_cast<size_t>(image.data_window.area());
  uint32_t seed = 1;
  for (const char* name : {"R", "G", "B", "A", "raw.R", "raw.G", "raw.B", "normal.X", "Z"}) {
    image.Add(name, RandomFloats(area, seed++));
  }
  image.Add("id", RandomUints(area, 50));
  image.Add("samples", RandomUints(area, 51));
  image.Add("error.R", RandomFloats(area, seed++));
  image.metadata["digest"] = std::string("abc");
  image.metadata["seed"] = int64_t{17};
  image.metadata["spp"] = 63.1;
  return image;
}

}  // namespace tessera
