// The project's own scenes load as expected; damaged files of any kind end in a Status.
#include "worker/scene/scene_loader.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <random>

#include "tests/worker/scene/scene_file.h"

namespace tessera {
namespace {

using ::testing::HasSubstr;

absl::StatusOr<std::unique_ptr<Scene>> LoadOwn(const std::string& name) {
  SceneRequest request;
  request.scene_name = name + ".glb";
  return LoadScene(request, DirectoryReader(TESSERA_SCENES_DIR));
}

void ExpectSound(const Scene& scene) {
  ASSERT_FALSE(scene.instances.empty());
  ASSERT_FALSE(scene.materials.empty());
  for (const Mesh& mesh : scene.meshes) {
    ASSERT_LT(static_cast<size_t>(mesh.material), scene.materials.size());
    for (const auto& triangle : mesh.triangles) {
      for (const uint32_t v : triangle) ASSERT_LT(v, mesh.positions.size());
    }
    for (const V3f& p : mesh.positions) {
      ASSERT_TRUE(std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z));
    }
    for (const V3f& n : mesh.normals) ASSERT_NEAR(n.length(), 1, 1e-4);
    ASSERT_TRUE(mesh.normals.empty() || mesh.normals.size() == mesh.positions.size());
  }
  for (const Instance& instance : scene.instances) {
    ASSERT_LT(static_cast<size_t>(instance.mesh), scene.meshes.size());
    ASSERT_GT(instance.to_world.determinant(), 0);
  }
  for (const Texture& texture : scene.textures) {
    ASSERT_EQ(texture.rgba.size(),
              static_cast<size_t>(texture.width) * static_cast<size_t>(texture.height) * 4);
  }
  ASSERT_NEAR(scene.camera.forward.length(), 1, 1e-5);
}

TEST(SceneLoader, OwnScenes) {
  struct Expected {
    const char* name;
    int64_t triangles_min;
    size_t lights;
    bool needs_sky;
  };
  for (const Expected& e :
       {Expected{"cornell", 36, 0, false}, Expected{"veach_mis", 1000, 0, false},
        Expected{"window_room", 5000, 0, true}, Expected{"still_life", 100000, 0, false},
        Expected{"many_lights", 10000, 40, false}, Expected{"wires", 10000, 0, true},
        Expected{"furnace", 1000, 0, true}, Expected{"furnace_closed", 1000, 0, false}}) {
    const auto scene = LoadOwn(e.name);
    ASSERT_TRUE(scene.ok()) << scene.status();
    ExpectSound(**scene);
    EXPECT_GE((*scene)->num_triangles(), e.triangles_min) << e.name;
    EXPECT_EQ((*scene)->lights.size(), e.lights) << e.name;
    EXPECT_EQ((*scene)->environment.has_value(), e.needs_sky) << e.name;
    EXPECT_EQ((*scene)->camera.name, "camera") << e.name;
    EXPECT_EQ((*scene)->notes.size(), e.needs_sky ? 1u : 0u) << e.name;
  }
}

TEST(SceneLoader, LoadsTheSameBitsEveryTime) {
  const auto a = LoadOwn("window_room"), b = LoadOwn("window_room");
  ASSERT_TRUE(a.ok() && b.ok());
  ASSERT_EQ((*a)->meshes.size(), (*b)->meshes.size());
  for (size_t i = 0; i < (*a)->meshes.size(); ++i) {
    EXPECT_EQ((*a)->meshes[i].positions, (*b)->meshes[i].positions);
    EXPECT_EQ((*a)->meshes[i].triangles, (*b)->meshes[i].triangles);
  }
  for (size_t i = 0; i < (*a)->textures.size(); ++i) {
    EXPECT_EQ((*a)->textures[i].rgba, (*b)->textures[i].rgba);
  }
}

std::string ReadBytes(const std::string& path) {
  std::ifstream stream(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

// Loads damaged bytes; a crash or a scene with dangling indices fails the test.
void LoadDamaged(const std::string& bytes) {
  SceneFile file;
  file.files["scene.gltf"] = bytes;
  file.request.memory_max_bytes = int64_t{256} << 20;
  const auto scene = file.Load();
  if (scene.ok()) {
    ExpectSound(**scene);
  } else {
    EXPECT_FALSE(scene.status().message().empty());
    EXPECT_EQ(scene.status().message().find('\n'), absl::string_view::npos);
  }
}

// Flips bytes of the JSON (the first `json_bytes`) or of the whole file.
void LoadFlipped(const std::string& intact, int rounds, uint32_t seed) {
  std::mt19937 random(seed);
  uint32_t json_bytes;
  std::memcpy(&json_bytes, intact.data() + 12, 4);
  for (int round = 0; round < rounds; ++round) {
    std::string bytes = intact;
    const size_t range = round % 2 == 0 ? 20 + json_bytes : bytes.size();
    const int flips = 1 + static_cast<int>(random() % 8);
    for (int i = 0; i < flips; ++i) {
      // Digits often: they change counts and offsets and leave the JSON well-formed.
      char& byte = bytes[random() % range];
      byte = byte >= '0' && byte <= '9' ? static_cast<char>('0' + random() % 10)
                                        : static_cast<char>(random() % 256);
    }
    ASSERT_NO_FATAL_FAILURE(LoadDamaged(bytes)) << "seed " << seed << " round " << round;
  }
}

TEST(SceneLoader, FlippedBytesNeverCrash) {
  LoadFlipped(ReadBytes(TESSERA_SCENES_DIR "/cornell.glb"), 3000, 1);
  LoadFlipped(ReadBytes(TESSERA_SCENES_DIR "/many_lights.glb"), 100, 2);
}

TEST(SceneLoader, FlippedTexturesNeverCrash) {
  LoadFlipped(ReadBytes(TESSERA_SCENES_DIR "/window_room.glb"), 40, 3);
}

TEST(SceneLoader, EveryTruncationIsAnError) {
  const std::string intact = ReadBytes(TESSERA_SCENES_DIR "/cornell.glb");
  for (size_t length = 0; length < intact.size(); length += 37) {
    SceneFile file;
    file.files["scene.gltf"] = intact.substr(0, length);
    EXPECT_FALSE(file.Load().ok()) << length;
  }
}

TEST(DirectoryReader, ReadsBesideAndRefusesToLeave) {
  const std::string directory = ::testing::TempDir() + "tessera_directory_reader_test";
  std::filesystem::create_directories(directory + "/sub");
  std::ofstream(directory + "/sub/a.bin") << "bytes";
  const AssetReader reader = DirectoryReader(directory);
  const auto bytes = reader("sub/a.bin");
  ASSERT_TRUE(bytes.ok()) << bytes.status();
  EXPECT_EQ(**bytes, "bytes");
  EXPECT_EQ(reader("b.bin").status().code(), absl::StatusCode::kNotFound);
  EXPECT_THAT(std::string(reader("b.bin").status().message()), HasSubstr("b.bin does not exist"));
  for (const char* name : {"../a.bin", "/etc/passwd", "sub/../../a", "", "sub"}) {
    EXPECT_EQ(reader(name).status().code(), absl::StatusCode::kInvalidArgument) << name;
  }
  std::filesystem::remove_all(directory);
}

}  // namespace
}  // namespace tessera
