// The sky around the scene: a map, a uniform radiance, or none.
#pragma once

#include <cstdint>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "worker/scene/scene.h"
#include "worker/scene/scene_loader.h"

namespace tessera {

// Bytes that the map of `choice` will take in memory, by its file's header; 0 without one.
// Errors: as ChooseEnvironment.
absl::StatusOr<int64_t> EnvironmentMapBytes(const EnvironmentChoice& choice,
                                            const AssetReader& read_asset);

// Sets scene->environment by `choice`. By default a scene without lights gets a neutral sky and a
// note that says so. Needs scene's instances, materials and lights.
// Errors: INVALID_ARGUMENT, NOT_FOUND naming the map or option.
absl::Status ChooseEnvironment(const EnvironmentChoice& choice, const AssetReader& read_asset,
                               Scene* scene);

// Whether anything in the scene sends light: punctual lights or emissive surfaces.
bool HasOwnLights(const Scene& scene);

}  // namespace tessera
