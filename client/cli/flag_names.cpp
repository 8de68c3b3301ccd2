#include "client/cli/flag_names.h"

#include <utility>

#include "absl/strings/str_replace.h"

namespace tessera {

std::string WithFlagNames(std::string text) {
  // Of fields that begin alike the longer one is replaced: absl prefers the longest match.
  return absl::StrReplaceAll(
      text, {
                {"settings.width x settings.height", "--size"},
                {"settings.width", "--size"},
                {"settings.height", "--size"},
                {"settings.region", "--region"},
                {"settings.look", "--look"},
                {"settings.tile_size", "--tile-size"},
                {"settings.spp", "--spp"},
                {"settings.max_depth", "--max-depth"},
                {"settings.auto_depth", "--max-depth auto"},
                {"settings.feature_spp", "--feature-spp"},
                {"settings.seed", "--seed"},
                {"settings.isa", "--isa"},
                {"settings.arithmetic", "--arithmetic"},
                {"settings.transparent", "--transparent"},
                {"settings.target_error", "--target-error"},
                {"settings.target_tile_error", "--target-tile-error"},
                {"settings.sampling", "--sampling"},
                {"settings.max_time", "--max-time"},
                {"settings.replay", "--replay"},
                {"settings.denoiser", "--denoiser"},
                {"settings.quality", "--quality"},
                {"settings.priority", "--priority"},
                {"settings.camera.name", "--camera"},
                {"settings.camera.look_at.fov_y_degrees", "--fov-y"},
                {"settings.camera.look_at", "--look-from, --look-at, --up"},
                {"settings.camera.lens_radius", "--lens-radius"},
                {"settings.camera.focus_distance", "--focus-distance"},
                {"settings.environment.map_name", "--env"},
                {"settings.environment.sky", "--sky"},
                {"settings.environment.rotate_degrees", "--env-rotate"},
                {"settings.assets", "the scene's files"},
                {"settings.scene_name", "the scene"},
                {"continue_film_sha256", "--continue"},
            });
}

}  // namespace tessera
