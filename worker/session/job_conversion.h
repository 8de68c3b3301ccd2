// From a job's settings on the wire to what the scene loader and the path tracer take, and back
// from a scene to the report that the server shows.
#pragma once

#include <cstdint>
#include <string>

#include "tessera/v1/job.pb.h"
#include "worker/integrator/path_tracer.h"
#include "worker/scene/scene.h"
#include "worker/scene/scene_loader.h"

namespace tessera {

inline constexpr char kDefaultIsaClass[] = "x86-64-v3";

// `memory_max_bytes`: 0 = unlimited.
SceneRequest SceneRequestOf(const v1::JobSettings& settings, int64_t memory_max_bytes);
RenderSettings RenderSettingsOf(const v1::JobSettings& settings, int build_threads);

// Of all the job's files; saturates, as sizes come from outside.
int64_t AssetBytesOf(const v1::JobSettings& settings);

// Names the built scene: the SHA-256 (hex) of the settings that a renderer depends on. Jobs that
// differ in spp, region, tile size, filter or priority only have the same key and share a scene.
std::string SceneKeyOf(const v1::JobSettings& settings);

// Everything but load_seconds and max_depth. The camera is given in glTF's world space.
v1::SceneReport SceneReportOf(const Scene& scene, int64_t memory_bytes);

}  // namespace tessera
