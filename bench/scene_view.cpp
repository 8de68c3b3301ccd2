#include "bench/scene_view.h"

#include <filesystem>

#include "worker/scene/scene_loader.h"

namespace tessera {

void AddViewOptions(CLI::App* app, SceneView* view) {
  app->add_option("--look-from", view->from)->delimiter(',')->expected(3);
  app->add_option("--look-at", view->at)->delimiter(',')->expected(3);
  app->add_option("--fov-y", view->fov_y);
  app->add_option("--env", view->env);
  app->add_option("--sky", view->sky)->delimiter(',')->expected(3);
}

absl::StatusOr<std::unique_ptr<Scene>> LoadView(const std::string& scene_path,
                                                const SceneView& view, double aspect) {
  const std::filesystem::path path = scene_path;
  SceneRequest request;
  request.scene_name = path.filename().string();
  if (view.from.size() == 3 && view.at.size() == 3) {
    request.camera.kind = CameraChoice::Kind::kLookAt;
    request.camera.from = V3d(view.from[0], view.from[1], view.from[2]);
    request.camera.at = V3d(view.at[0], view.at[1], view.at[2]);
    request.camera.fov_y_degrees = view.fov_y;
  }
  if (!view.env.empty()) {
    request.environment.kind = EnvironmentChoice::Kind::kMap;
    request.environment.map_name = view.env;
  } else if (view.sky.size() == 3) {
    request.environment.kind = EnvironmentChoice::Kind::kSky;
    request.environment.sky = V3d(view.sky[0], view.sky[1], view.sky[2]);
  }
  request.aspect = aspect;
  return LoadScene(request,
                   DirectoryReader(path.parent_path().empty() ? "." : path.parent_path()));
}

}  // namespace tessera
