#include "worker/scene/gltf_lights.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "worker/scene/status_macros.h"

namespace tessera {
namespace {

constexpr double kIntensityMax = 1e12;

PunctualLight ReadLight(const GltfObject& object) {
  PunctualLight light;
  light.name = object.Text("name");
  const std::string type = object.Text("type");
  if (type == "directional") {
    light.type = LightType::kDirectional;
  } else if (type == "spot") {
    light.type = LightType::kSpot;
  } else if (type != "point") {
    object.Fail("type", "must be point, spot or directional");
  }
  const auto color = object.Numbers<3>("color", {1, 1, 1});
  const double intensity = std::clamp(object.Number("intensity", 1), 0.0, kIntensityMax);
  for (int c = 0; c < 3; ++c) {
    light.intensity[c] = static_cast<float>(
        std::clamp(color[static_cast<size_t>(c)], 0.0, kIntensityMax) * intensity);
  }
  light.range = static_cast<float>(std::max(object.Number("range", 0), 0.0));

  // The inner cone lies inside the outer one.
  const GltfObject spot = object.Object("spot");
  const double half_pi = std::numbers::pi / 2;
  const double outer =
      std::clamp(spot.Number("outerConeAngle", std::numbers::pi / 4), 0.0, half_pi);
  const double inner = std::clamp(spot.Number("innerConeAngle", 0), 0.0, outer);
  light.inner_cone_cos = static_cast<float>(std::cos(inner));
  light.outer_cone_cos = static_cast<float>(std::cos(outer));
  return light;
}

}  // namespace

absl::StatusOr<std::vector<PunctualLight>> ReadLights(const GltfDocument& document,
                                                      const std::vector<GltfNode>& nodes,
                                                      const V3d& origin) {
  std::vector<PunctualLight> kinds;
  for (const GltfObject& object :
       document.Root().Extension("KHR_lights_punctual").Objects("lights")) {
    kinds.push_back(ReadLight(object));
  }
  TESSERA_RETURN_IF_ERROR(document.status());

  std::vector<PunctualLight> lights;
  for (const GltfNode& node : nodes) {
    if (!node.in_scene || node.light < 0) continue;
    PunctualLight light = kinds[static_cast<size_t>(node.light)];
    if (light.name.empty()) light.name = node.name;
    light.position = V3f(node.to_world.translation() - origin);
    V3d forward;
    node.to_world.multDirMatrix(V3d(0, 0, -1), forward);
    if (forward.length() > 0) light.direction = V3f(forward.normalized());
    lights.push_back(light);
  }
  return lights;
}

}  // namespace tessera
