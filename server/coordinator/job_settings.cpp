#include "server/coordinator/job_settings.h"

#include <algorithm>
#include <cmath>
#include <set>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "core/base/isa_classes.h"
#include "core/base/tile_grid.h"
#include "server/coordinator/limits.h"
#include "server/coordinator/sample_counts.h"
#include "server/coordinator/sample_plan.h"

namespace tessera {
namespace {

template <typename... Parts>
absl::Status Invalid(const Parts&... parts) {
  return absl::InvalidArgumentError(absl::StrCat(parts...));
}

bool IsFinite(const v1::Vec3& v) {
  return std::isfinite(v.x()) && std::isfinite(v.y()) && std::isfinite(v.z());
}

absl::Status CheckFrame(const v1::JobSettings& s) {
  if (s.width() < 1 || s.height() < 1) {
    return Invalid("settings.width x settings.height is ", s.width(), "x", s.height(),
                   ": ask for at least 1x1 pixels");
  }
  if (s.width() > kFrameSideMaxPx || s.height() > kFrameSideMaxPx ||
      int64_t{s.width()} * s.height() > kFramePixelsMax) {
    return Invalid("settings.width x settings.height is ", s.width(), "x", s.height(),
                   ": ask for at most ", kFrameSideMaxPx, " pixels a side and ", kFramePixelsMax,
                   " in all, or render the frame in parts");
  }
  if (s.has_region()) {
    if (absl::Status status = CheckRegion(s, s.region(), "settings.region"); !status.ok()) {
      return status;
    }
  }
  if (s.has_look()) {
    if (absl::Status status = CheckRegion(s, s.look(), "settings.look"); !status.ok()) {
      return status;
    }
  }
  if (s.tile_size() < 1 || s.tile_size() > kTileSizeMaxPx) {
    return Invalid("settings.tile_size is ", s.tile_size(), ": give 1 to ", kTileSizeMaxPx,
                   " pixels, or 0 for the server's default");
  }
  const PixelRect region = RegionOf(s);
  const int64_t columns = (region.width() + s.tile_size() - 1) / s.tile_size();
  const int64_t rows = (region.height() + s.tile_size() - 1) / s.tile_size();
  if (columns * rows > kTilesMax && IsAdaptive(s)) {
    return Invalid("settings.sampling: by need it cuts the region into ", columns * rows,
                   " cells, more than ", kTilesMax,
                   ": sample uniformly (--sampling uniform), or render the frame in parts");
  }
  if (columns * rows > kTilesMax) {
    return Invalid("settings.tile_size ", s.tile_size(), " cuts the region into ", columns * rows,
                   " tiles, more than ", kTilesMax, ": give a larger tile size");
  }
  return absl::OkStatus();
}

absl::Status CheckBudget(const v1::JobSettings& s) {
  if (s.spp() < 1 || s.spp() > kSppMax) {
    return Invalid("settings.spp is ", s.spp(), ": give 1 to ", kSppMax, " samples per pixel");
  }
  if (s.max_depth() < 0 || s.max_depth() > kMaxDepthMax) {
    return Invalid("settings.max_depth is ", s.max_depth(), ": give 0 to ", kMaxDepthMax,
                   " bounces");
  }
  if (s.auto_depth() && s.max_depth() != 0) {
    return Invalid("settings.auto_depth: cannot be combined with max_depth: drop one of them");
  }
  if (!IsFeatureEnd(FeatureEndOf(s.feature_spp()))) {
    return Invalid("settings.feature_spp is ", s.feature_spp(),
                   ": give a power of two such as 64, or 0 for every sample");
  }
  if (!std::isfinite(s.target_error()) || s.target_error() < 0) {
    return Invalid("settings.target_error is ", s.target_error(),
                   ": give a positive number such as 0.02, or 0 for none");
  }
  if (!std::isfinite(s.target_tile_error()) || s.target_tile_error() < 0) {
    return Invalid("settings.target_tile_error is ", s.target_tile_error(),
                   ": give a positive number such as 0.05, or 0 for none");
  }
  if (s.has_max_time()) {
    const auto& t = s.max_time();
    if (t.seconds() < 0 || t.nanos() < 0 || t.nanos() > 999999999 ||
        (t.seconds() == 0 && t.nanos() == 0) || t.seconds() > int64_t{10} * 366 * 86400) {
      return Invalid("settings.max_time is ", t.seconds(), " s: give a positive time");
    }
  }
  if (!v1::Sampling_IsValid(s.sampling())) {
    return Invalid("settings.sampling ", static_cast<int>(s.sampling()), " is unknown");
  }
  if (IsAdaptive(s) && !HasTargetError(s) && !s.has_max_time()) {
    return Invalid("settings.sampling is adaptive: give target_error, target_tile_error or "
                   "max_time with it, for a number of samples says nothing of when to stop");
  }
  if (!IsAdaptive(s) && s.target_tile_error() > 0) {
    return Invalid("settings.target_tile_error needs samples where cells need them: leave "
                   "settings.sampling away or make it adaptive");
  }
  if (s.priority() < -kPriorityMax || s.priority() > kPriorityMax) {
    return Invalid("settings.priority is ", s.priority(), ": give -", kPriorityMax, " to ",
                   kPriorityMax);
  }
  return absl::OkStatus();
}

absl::Status CheckReplay(const v1::JobSettings& s) {
  if (!s.has_replay()) return absl::OkStatus();
  if (HasTargetError(s) || s.has_max_time()) {
    return Invalid("settings.replay: cannot be combined with target_error, target_tile_error or "
                   "max_time: a replay has the samples of its picture, no more and no less");
  }
  const v1::SampleCounts& counts = s.replay().counts();
  if (counts.tile_size() != s.tile_size()) {
    return Invalid("settings.replay: its counts are for tiles of ", counts.tile_size(),
                   " pixels, settings.tile_size is ", s.tile_size(), ": make them equal");
  }
  return CheckCounts(counts, TileGrid(RegionOf(s), s.tile_size()).num_tiles(), s.spp());
}

absl::Status CheckCamera(const v1::Camera& camera) {
  if (camera.has_look_at()) {
    const v1::LookAt& look = camera.look_at();
    if (!IsFinite(look.from()) || !IsFinite(look.at()) || !IsFinite(look.up())) {
      return Invalid("settings.camera.look_at has a coordinate that is not finite");
    }
    if (look.from().x() == look.at().x() && look.from().y() == look.at().y() &&
        look.from().z() == look.at().z()) {
      return Invalid("settings.camera.look_at: from and at are the same point: move one of them");
    }
    if (!(look.fov_y_degrees() > 0 && look.fov_y_degrees() < 180)) {
      return Invalid("settings.camera.look_at.fov_y_degrees is ", look.fov_y_degrees(),
                     ": give an angle between 0 and 180");
    }
  }
  if (!(camera.lens_radius() >= 0) || !std::isfinite(camera.lens_radius())) {
    return Invalid("settings.camera.lens_radius is ", camera.lens_radius(),
                   ": give metres, 0 for a pinhole");
  }
  if (!(camera.focus_distance() >= 0) || !std::isfinite(camera.focus_distance())) {
    return Invalid("settings.camera.focus_distance is ", camera.focus_distance(),
                   ": give metres, at least 0");
  }
  return absl::OkStatus();
}

// A relative path that stays inside the scene's folder.
bool IsInsideName(const std::string& name) {
  if (name.empty() || name.size() > kNameBytesMax || name.front() == '/') return false;
  if (name.find('\0') != std::string::npos || name.find('\\') != std::string::npos) return false;
  for (absl::string_view part : absl::StrSplit(name, '/')) {
    if (part.empty() || part == "." || part == "..") return false;
  }
  return true;
}

absl::Status CheckAssets(const v1::JobSettings& s) {
  if (s.assets_size() > kAssetsMax) {
    return Invalid("settings.assets has ", s.assets_size(), " files, more than ", kAssetsMax);
  }
  std::set<std::string> names;
  for (const v1::AssetRef& asset : s.assets()) {
    if (!IsInsideName(asset.name())) {
      return Invalid("settings.assets: '", asset.name().substr(0, 200),
                     "' is not a relative path inside the scene's folder");
    }
    if (asset.sha256().size() != 32) {
      return Invalid("settings.assets: the sha256 of '", asset.name(), "' is ",
                     asset.sha256().size(), " bytes long: give 32");
    }
    if (asset.size_bytes() < 0 || asset.size_bytes() > kAssetBytesMax) {
      return Invalid("settings.assets: the size of '", asset.name(), "' is ", asset.size_bytes(),
                     " bytes: give 0 to ", kAssetBytesMax);
    }
    if (!names.insert(asset.name()).second) {
      return Invalid("settings.assets names '", asset.name(), "' twice");
    }
  }
  if (!names.contains(s.scene_name())) {
    return Invalid("settings.scene_name '", s.scene_name().substr(0, 200),
                   "' is not among settings.assets: name the .glb or .gltf");
  }
  const v1::Environment& environment = s.environment();
  if (environment.has_map_name() && !names.contains(environment.map_name())) {
    return Invalid("settings.environment.map_name '", environment.map_name().substr(0, 200),
                   "' is not among settings.assets: add the file");
  }
  if (environment.has_sky()) {
    const v1::Vec3& sky = environment.sky();
    if (!IsFinite(sky) || sky.x() < 0 || sky.y() < 0 || sky.z() < 0) {
      return Invalid("settings.environment.sky ", sky.x(), ",", sky.y(), ",", sky.z(),
                     ": give three radiances of at least 0");
    }
  }
  if (!std::isfinite(environment.rotate_degrees())) {
    return Invalid("settings.environment.rotate_degrees is not finite");
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status CheckRegion(const v1::JobSettings& s, const v1::Region& r, const char* field) {
  if (r.width() < 1 || r.height() < 1 || r.x() < 0 || r.y() < 0 ||
      r.width() > s.width() - r.x() || r.height() > s.height() - r.y()) {
    return Invalid(field, " ", r.x(), ",", r.y(), ",", r.width(), ",", r.height(),
                   " is not inside the frame of ", s.width(), "x", s.height(),
                   ": give X,Y,W,H with 0 <= X, 0 <= Y, X+W <= ", s.width(),
                   ", Y+H <= ", s.height());
  }
  return absl::OkStatus();
}

const std::vector<std::string>& IsaClasses() {
  static const auto* const kClasses = new std::vector<std::string>(kIsaClasses.begin(),
                                                                 kIsaClasses.end());
  return *kClasses;
}

absl::StatusOr<v1::JobSettings> CompleteSettings(v1::JobSettings settings,
                                                 const SettingsDefaults& defaults) {
  if (settings.ByteSizeLong() > kSettingsBytesMax) {
    return Invalid("settings have ", settings.ByteSizeLong(), " bytes, more than ",
                   kSettingsBytesMax, ": join the scene's files, as a .glb does");
  }
  if (settings.isa().empty()) settings.set_isa(IsaClasses().front());
  if (settings.sampling() == v1::SAMPLING_UNSPECIFIED) {
    settings.set_sampling(HasTargetError(settings) ? v1::SAMPLING_ADAPTIVE
                                                   : v1::SAMPLING_UNIFORM);
  }
  if (IsAdaptive(settings)) settings.set_tile_size(kCellSizePx);
  if (settings.tile_size() == 0) settings.set_tile_size(defaults.tile_size);
  if (!settings.has_feature_spp()) settings.set_feature_spp(defaults.feature_spp);
  if (settings.quality() == v1::QUALITY_UNSPECIFIED) settings.set_quality(v1::QUALITY_FINAL);
  if (settings.denoiser().empty() && !defaults.denoisers.empty()) {
    settings.set_denoiser(defaults.denoisers.front());
  }
  if (std::ranges::find(IsaClasses(), settings.isa()) == IsaClasses().end()) {
    return Invalid("settings.isa '", settings.isa().substr(0, 64), "' is unknown: give one of ",
                   absl::StrJoin(IsaClasses(), ", "));
  }
  if (!settings.arithmetic().empty() && !IsArithmetic(settings.arithmetic())) {
    return Invalid("settings.arithmetic '", settings.arithmetic().substr(0, 64),
                   "' is none: give 16 hexadecimal digits, as 'tessera workers' shows them, or "
                   "nothing to take any");
  }
  if (std::ranges::find(defaults.denoisers, settings.denoiser()) == defaults.denoisers.end()) {
    return Invalid("settings.denoiser '", settings.denoiser().substr(0, 64),
                   "' is unknown: give one of ", absl::StrJoin(defaults.denoisers, ", "));
  }
  if (!v1::Quality_IsValid(settings.quality())) {
    return Invalid("settings.quality ", static_cast<int>(settings.quality()), " is unknown");
  }
  for (const absl::Status& status : {CheckFrame(settings), CheckBudget(settings),
                                     CheckCamera(settings.camera()), CheckAssets(settings)}) {
    if (!status.ok()) return status;
  }
  // Needs a frame that is possible.
  if (absl::Status status = CheckReplay(settings); !status.ok()) return status;
  return settings;
}

bool IsAdaptive(const v1::JobSettings& settings) {
  return settings.sampling() == v1::SAMPLING_ADAPTIVE;
}

bool HasTargetError(const v1::JobSettings& settings) {
  return settings.target_error() > 0 || settings.target_tile_error() > 0;
}

bool DecidesByPicture(const v1::JobSettings& settings) {
  return HasTargetError(settings) || IsAdaptive(settings);
}

Film EmptyFilmOf(const v1::JobSettings& settings) {
  return Film(TileGrid(RegionOf(settings), settings.tile_size()),
              FeatureEndOf(settings.feature_spp()));
}

PixelRect RegionOf(const v1::JobSettings& settings) {
  if (settings.has_region()) return RectOf(settings.region());
  return PixelRect::FromSize(0, 0, settings.width(), settings.height());
}

PixelRect RectOf(const v1::Region& region) {
  // Peers may send any numbers: a sum that no int holds gives an empty rectangle.
  const int64_t x_end = int64_t{region.x()} + region.width();
  const int64_t y_end = int64_t{region.y()} + region.height();
  if (!std::in_range<int>(x_end) || !std::in_range<int>(y_end)) return {};
  return {region.x(), region.y(), static_cast<int>(x_end), static_cast<int>(y_end)};
}

v1::Region RegionProto(const PixelRect& rect) {
  v1::Region region;
  region.set_x(rect.x_begin);
  region.set_y(rect.y_begin);
  region.set_width(rect.width());
  region.set_height(rect.height());
  return region;
}

}  // namespace tessera
