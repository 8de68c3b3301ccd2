#include "worker/scene/environment_map.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "absl/strings/str_cat.h"
#include "worker/scene/image_file.h"
#include "worker/scene/status_macros.h"

namespace tessera {
namespace {

constexpr float kTexelMax = 1e9f;     // brighter than any sun in a sane map
constexpr float kHalfMax = 65504.0f;  // what an infinity in a half-float file stands for

// Returns whether the value had to change.
bool CleanTexel(float* value) {
  if (*value >= 0 && *value <= kTexelMax) return false;
  if (std::isnan(*value) || *value < 0) {
    *value = 0;
  } else {
    *value = std::isinf(*value) ? kHalfMax : kTexelMax;
  }
  return true;
}

absl::Status AtEnvironment(const std::string& name, const absl::Status& status) {
  return absl::Status(status.code(), absl::StrCat("environment ", name, ": ", status.message()));
}

absl::Status ReadMap(const std::string& name, const AssetReader& read_asset,
                     EnvironmentLight* environment, std::vector<std::string>* notes) {
  TESSERA_ASSIGN_OR_RETURN(const auto file, read_asset(name));
  absl::StatusOr<ImageSize> size = DecodeRadiance(*file, &environment->texels);
  if (!size.ok()) return AtEnvironment(name, size.status());
  environment->width = size->width;
  environment->height = size->height;
  int64_t num_changed = 0;
  for (V3f& texel : environment->texels) {
    for (int c = 0; c < 3; ++c) num_changed += CleanTexel(&texel[c]);
  }
  if (num_changed > 0) {
    notes->push_back(absl::StrCat("environment ", name, ": ", num_changed,
                                  " negative, non-finite or huge values were clamped"));
  }
  return absl::OkStatus();
}

}  // namespace

bool HasOwnLights(const Scene& scene) {
  const auto shines = [](const PunctualLight& light) { return light.intensity.length2() > 0; };
  if (std::any_of(scene.lights.begin(), scene.lights.end(), shines)) return true;
  return std::any_of(scene.instances.begin(), scene.instances.end(), [&](const Instance& instance) {
    const Mesh& mesh = scene.meshes[static_cast<size_t>(instance.mesh)];
    return scene.materials[static_cast<size_t>(mesh.material)].emission.length2() > 0;
  });
}

absl::StatusOr<int64_t> EnvironmentMapBytes(const EnvironmentChoice& choice,
                                            const AssetReader& read_asset) {
  if (choice.kind != EnvironmentChoice::Kind::kMap) return 0;
  TESSERA_ASSIGN_OR_RETURN(const auto file, read_asset(choice.map_name));
  const absl::StatusOr<ImageSize> size = ReadRadianceSize(*file);
  if (!size.ok()) return AtEnvironment(choice.map_name, size.status());
  return int64_t{size->width} * size->height * static_cast<int64_t>(sizeof(V3f));
}

absl::Status ChooseEnvironment(const EnvironmentChoice& choice, const AssetReader& read_asset,
                               Scene* scene) {
  if (!std::isfinite(choice.rotate_degrees)) {
    return absl::InvalidArgumentError("environment: env-rotate must be a finite number of degrees");
  }
  EnvironmentLight environment;
  // Whole turns are taken off in double, so that large angles keep their meaning.
  environment.rotate_radians =
      static_cast<float>(std::remainder(choice.rotate_degrees, 360.0) * (std::numbers::pi / 180));
  switch (choice.kind) {
    case EnvironmentChoice::Kind::kMap:
      TESSERA_RETURN_IF_ERROR(ReadMap(choice.map_name, read_asset, &environment, &scene->notes));
      scene->environment = std::move(environment);
      break;
    case EnvironmentChoice::Kind::kSky:
      for (int c = 0; c < 3; ++c) {
        if (!(choice.sky[c] >= 0 && choice.sky[c] <= double{kTexelMax})) {
          return absl::InvalidArgumentError(
              "environment: sky must be three radiances from 0 to 1e9");
        }
      }
      environment.uniform = V3f(choice.sky);
      scene->environment = std::move(environment);
      break;
    case EnvironmentChoice::Kind::kDefault:
      if (HasOwnLights(*scene)) break;
      environment.uniform = V3f(1, 1, 1);
      scene->environment = std::move(environment);
      scene->notes.push_back(
          "the scene has no lights: a neutral sky of radiance 1 is used; choose with env or sky");
      break;
  }
  return absl::OkStatus();
}

}  // namespace tessera
