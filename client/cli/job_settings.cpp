#include "client/cli/job_settings.h"

#include <algorithm>
#include <string>
#include <vector>

#include <google/protobuf/util/message_differencer.h>
#include <google/protobuf/util/time_util.h>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "client/cli/parse_values.h"
#include "core/base/isa_classes.h"
#include "core/denoise/denoiser.h"

namespace tessera {
namespace {

using google::protobuf::util::TimeUtil;

constexpr double kCoordinateMax = 1e12;  // metres
constexpr int kMaxDepthDefault = 8;
constexpr int kMaxDepthMax = 1024;
constexpr int64_t kFeatureSppMax = int64_t{1} << 30;
constexpr int kTileSizeMax = 64;
constexpr int kPriorityMax = 1000000;

absl::Status Conflict(const std::string& line) { return absl::InvalidArgumentError(line); }

// Parses flags one after the other; after the first error all others are skipped.
class FlagReader {
 public:
  template <typename Parse, typename Set>
  void Read(const std::string& flag, const std::string& text, Parse parse, Set set) {
    if (!status_.ok() || text.empty()) return;
    auto value = parse(flag, text);
    if (value.ok()) {
      set(*value);
    } else {
      status_ = value.status();
    }
  }
  template <typename Set>
  void Integer(const std::string& flag, const std::string& text, int64_t min, int64_t max,
               Set set) {
    Read(flag, text, [&](auto& f, auto& t) { return ParseInteger(f, t, min, max); }, set);
  }
  template <typename Set>
  void Number(const std::string& flag, const std::string& text, double min, double max, Set set) {
    Read(flag, text, [&](auto& f, auto& t) { return ParseNumber(f, t, min, max); }, set);
  }
  void Fail(const std::string& line) {
    if (status_.ok()) status_ = Conflict(line);
  }
  const absl::Status& status() const { return status_; }

 private:
  absl::Status status_;
};

void ReadCamera(const SceneFlags& flags, FlagReader* reader, v1::Camera* camera) {
  const bool look = !flags.look_from.empty() || !flags.look_at.empty() || !flags.up.empty() ||
                    !flags.fov_y.empty();
  if (!flags.camera.empty() && look) {
    reader->Fail("--camera: cannot be combined with --look-from, --look-at, --up, --fov-y; "
                 "drop one of them");
  }
  if (!flags.camera.empty()) camera->set_name(flags.camera);
  if (look) {
    if (flags.look_from.empty() || flags.look_at.empty() || flags.fov_y.empty()) {
      reader->Fail("--look-from, --look-at and --fov-y belong together: give all three");
    }
    v1::LookAt* at = camera->mutable_look_at();
    reader->Read("--look-from", flags.look_from, ParseVec3,
                 [&](const v1::Vec3& v) { *at->mutable_from() = v; });
    reader->Read("--look-at", flags.look_at, ParseVec3,
                 [&](const v1::Vec3& v) { *at->mutable_at() = v; });
    reader->Read("--up", flags.up, ParseVec3, [&](const v1::Vec3& v) { *at->mutable_up() = v; });
    reader->Number("--fov-y", flags.fov_y, 0.001, 179,
                   [&](double v) { at->set_fov_y_degrees(v); });
    if (reader->status().ok() && at->from().x() == at->at().x() &&
        at->from().y() == at->at().y() && at->from().z() == at->at().z()) {
      reader->Fail(absl::StrCat("--look-at ", flags.look_at,
                                ": is the same point as --look-from; move one of them"));
    }
    if (reader->status().ok() && at->has_up() && at->up().x() == 0 && at->up().y() == 0 &&
        at->up().z() == 0) {
      reader->Fail("--up 0,0,0: must not be zero; 0,1,0 is the default");
    }
  }
  reader->Number("--lens-radius", flags.lens_radius, 0, kCoordinateMax,
                 [&](double v) { camera->set_lens_radius(v); });
  reader->Number("--focus-distance", flags.focus_distance, 0, kCoordinateMax,
                 [&](double v) { camera->set_focus_distance(v); });
}

void ReadEnvironment(const SceneFlags& flags, FlagReader* reader, v1::Environment* environment) {
  if (!flags.env.empty() && !flags.sky.empty()) {
    reader->Fail("--sky: cannot be combined with --env; drop one of them");
  }
  if (!flags.env_rotate.empty() && flags.env.empty() && environment->map_name().empty()) {
    reader->Fail("--env-rotate: turns an environment map; give one with --env");
  }
  reader->Read("--sky", flags.sky, ParseVec3, [&](const v1::Vec3& v) {
    if (v.x() < 0 || v.y() < 0 || v.z() < 0) {
      reader->Fail(absl::StrCat("--sky ", flags.sky, ": must not be negative"));
    }
    *environment->mutable_sky() = v;
  });
  reader->Number("--env-rotate", flags.env_rotate, -36000, 36000,
                 [&](double v) { environment->set_rotate_degrees(v); });
}

void ReadFrame(const SceneFlags& flags, FlagReader* reader, v1::JobSettings* settings) {
  reader->Read("--size", flags.size, ParseSize, [&](const FrameSize& size) {
    settings->set_width(size.width);
    settings->set_height(size.height);
  });
  reader->Read("--region", flags.region, ParseRegion,
               [&](const v1::Region& region) { *settings->mutable_region() = region; });
  settings->clear_look();
  reader->Read("--look", flags.look, ParseRegion,
               [&](const v1::Region& region) { *settings->mutable_look() = region; });
  for (const char* flag : {"--region", "--look"}) {
    const v1::Region& region = flag == std::string("--look") ? settings->look()
                                                             : settings->region();
    if (region.x() + region.width() <= settings->width() &&
        region.y() + region.height() <= settings->height()) {
      continue;
    }
    reader->Fail(absl::StrCat(flag, " ", region.x(), ",", region.y(), ",", region.width(), ",",
                              region.height(), ": must lie inside the frame of ",
                              settings->width(), "x", settings->height(), " pixels; see --size"));
  }
}

bool HasTarget(const v1::JobSettings& settings) {
  return settings.target_error() > 0 || settings.target_tile_error() > 0;
}

absl::StatusOr<int64_t> ParseFeatureSpp(const std::string& flag, const std::string& text) {
  if (text == "all") return 0;
  const absl::StatusOr<int64_t> spp = ParseInteger(flag, text, 0, kFeatureSppMax);
  if (spp.ok() && *spp == 1) {
    return Conflict(absl::StrCat(flag, " 1: one sample has no variance, so filters could not use ",
                                 "the features: give 2 or more, or all for every sample"));
  }
  if (!spp.ok() || (*spp & (*spp - 1)) == 0) return spp;
  return Conflict(absl::StrCat(flag, " ", text,
                               ": must be a power of two such as 64, or all for every sample"));
}

absl::StatusOr<int64_t> ParseMaxDepth(const std::string& flag, const std::string& text) {
  const absl::StatusOr<int64_t> depth = ParseInteger(flag, text, 0, kMaxDepthMax);
  if (depth.ok()) return depth;
  return Conflict(absl::StrCat(depth.status().message(), ", or auto"));
}

void ReadBudget(const SceneFlags& flags, FlagReader* reader, v1::JobSettings* settings) {
  reader->Integer("--spp", flags.spp, 1, kSppMax, [&](int64_t v) { settings->set_spp(v); });
  reader->Number("--target-error", flags.target_error, 1e-6, 1e3,
                 [&](double v) { settings->set_target_error(v); });
  reader->Number("--target-tile-error", flags.target_tile_error, 1e-6, 1e3,
                 [&](double v) { settings->set_target_tile_error(v); });
  reader->Number("--max-time", flags.max_time, 0.001, 1e9, [&](double v) {
    *settings->mutable_max_time() =
        TimeUtil::MicrosecondsToDuration(static_cast<int64_t>(v * 1e6));
  });
  if (flags.sampling == "adaptive") {
    settings->set_sampling(v1::SAMPLING_ADAPTIVE);
  } else if (flags.sampling == "uniform") {
    settings->set_sampling(v1::SAMPLING_UNIFORM);
  } else if (!flags.sampling.empty()) {
    reader->Fail(absl::StrCat("--sampling ", flags.sampling, ": must be adaptive or uniform"));
  }
  if (settings->spp() == 0) {
    const bool open_ended = HasTarget(*settings) || settings->has_max_time();
    settings->set_spp(open_ended ? kSppOpenEnded : kSppDefault);
  }
  if (flags.max_depth == "auto") {
    settings->clear_max_depth();
    settings->set_auto_depth(true);
  } else {
    reader->Read("--max-depth", flags.max_depth, ParseMaxDepth,
                 [&](int64_t v) { settings->set_max_depth(static_cast<int>(v)); });
  }
  reader->Read("--feature-spp", flags.feature_spp, ParseFeatureSpp,
               [&](int64_t v) { settings->set_feature_spp(v); });
  reader->Read("--seed", flags.seed, ParseUnsigned, [&](uint64_t v) { settings->set_seed(v); });
}

void ReadServing(const SceneFlags& flags, FlagReader* reader, v1::JobSettings* settings) {
  if (!flags.denoiser.empty()) {
    const std::vector<std::string> names = DenoiserNames();
    if (std::find(names.begin(), names.end(), flags.denoiser) == names.end()) {
      reader->Fail(absl::StrCat("--denoiser ", flags.denoiser, ": must be one of ",
                                absl::StrJoin(names, ", ")));
    }
    settings->set_denoiser(flags.denoiser);
  }
  if (!flags.isa.empty()) {
    if (std::find(kIsaClasses.begin(), kIsaClasses.end(), flags.isa) == kIsaClasses.end()) {
      reader->Fail(absl::StrCat("--isa ", flags.isa, ": must be one of ",
                                absl::StrJoin(kIsaClasses, ", ")));
    }
    settings->set_isa(flags.isa);
  }
  if (flags.arithmetic == kAnyArithmetic) {
    settings->clear_arithmetic();
  } else if (!flags.arithmetic.empty()) {
    if (!IsArithmetic(flags.arithmetic)) {
      reader->Fail(absl::StrCat("--arithmetic ", flags.arithmetic, ": must be 16 hexadecimal "
                                "digits, as 'tessera workers' shows them, or any"));
    }
    settings->set_arithmetic(flags.arithmetic);
  }
  if (flags.quality == "preview") {
    settings->set_quality(v1::QUALITY_PREVIEW);
  } else if (flags.quality == "final") {
    settings->set_quality(v1::QUALITY_FINAL);
  } else if (!flags.quality.empty()) {
    reader->Fail(absl::StrCat("--quality ", flags.quality, ": must be preview or final"));
  }
  reader->Integer("--tile-size", flags.tile_size, 1, kTileSizeMax,
                  [&](int64_t v) { settings->set_tile_size(static_cast<int>(v)); });
  reader->Integer("--priority", flags.priority, -kPriorityMax, kPriorityMax,
                  [&](int64_t v) { settings->set_priority(static_cast<int>(v)); });
}

// What of a film's budget goes on: a new goal replaces its goal, and how long the last render took
// is not how long this one may, unless nothing else would ever end it.
void TakeUpBudget(const SceneFlags& flags, v1::JobSettings* settings) {
  const bool has_target = !flags.target_error.empty() || !flags.target_tile_error.empty();
  if (has_target) settings->clear_spp();
  if (has_target || !flags.spp.empty()) {
    settings->clear_target_error();
    settings->clear_target_tile_error();
  }
  if (!HasTarget(*settings) || !flags.sampling.empty()) settings->clear_sampling();
  const bool open_ended = settings->spp() == kSppOpenEnded && !HasTarget(*settings);
  if (!open_ended || !flags.spp.empty()) settings->clear_max_time();
}

bool SameAssets(const v1::JobSettings& a, const v1::JobSettings& b) {
  const auto digest_of = [](const v1::JobSettings& settings, const std::string& name) {
    for (const v1::AssetRef& asset : settings.assets()) {
      if (asset.name() == name) return asset.sha256();
    }
    return std::string();
  };
  if (a.assets_size() != b.assets_size()) return false;
  for (const v1::AssetRef& asset : a.assets()) {
    // The scene and the environment may have been renamed; what the scene names may not.
    if (asset.name() == a.scene_name()) {
      if (asset.sha256() != digest_of(b, b.scene_name())) return false;
    } else if (asset.name() == a.environment().map_name()) {
      if (asset.sha256() != digest_of(b, b.environment().map_name())) return false;
    } else if (asset.sha256() != digest_of(b, asset.name())) {
      return false;
    }
  }
  return true;
}

}  // namespace

absl::StatusOr<v1::JobSettings> SettingsFromFlags(const SceneFlags& flags,
                                                  const v1::JobSettings* film) {
  v1::JobSettings settings;
  if (film != nullptr) {
    settings = *film;
    settings.clear_replay();
    TakeUpBudget(flags, &settings);
  } else {
    settings.set_width(640);
    settings.set_height(360);
    settings.set_max_depth(kMaxDepthDefault);
  }
  settings.clear_assets();
  FlagReader reader;
  ReadCamera(flags, &reader, settings.mutable_camera());
  ReadEnvironment(flags, &reader, settings.mutable_environment());
  ReadFrame(flags, &reader, &settings);
  ReadBudget(flags, &reader, &settings);
  ReadServing(flags, &reader, &settings);
  if (flags.transparent) settings.set_transparent(true);
  if (!reader.status().ok()) return reader.status();
  return settings;
}

void SetAssets(const SceneAssets& assets, v1::JobSettings* settings) {
  settings->set_scene_name(assets.scene_name);
  if (!assets.environment_name.empty()) {
    settings->mutable_environment()->set_map_name(assets.environment_name);
  }
  settings->clear_assets();
  for (const AssetFile& file : assets.files) {
    v1::AssetRef* asset = settings->add_assets();
    asset->set_name(file.name);
    asset->set_sha256(ToBytes(file.sha256));
    asset->set_size_bytes(file.size_bytes);
  }
}

absl::Status CheckContinues(const std::string& flag, const v1::JobSettings& film,
                            const v1::JobSettings& job) {
  using google::protobuf::util::MessageDifferencer;
  std::vector<std::string> differences;
  if (!SameAssets(film, job)) differences.push_back("the scene's files");
  if (!MessageDifferencer::Equivalent(film.camera(), job.camera())) {
    differences.push_back("the camera");
  }
  v1::Environment film_environment = film.environment();
  v1::Environment job_environment = job.environment();
  if (!film_environment.map_name().empty() && !job_environment.map_name().empty()) {
    film_environment.set_map_name(job_environment.map_name());
  }
  if (!MessageDifferencer::Equivalent(film_environment, job_environment)) {
    differences.push_back("the environment");
  }
  if (film.width() != job.width() || film.height() != job.height()) {
    differences.push_back(absl::StrCat("--size (the film's is ", film.width(), "x", film.height(),
                                       ")"));
  }
  if (!MessageDifferencer::Equivalent(film.region(), job.region())) {
    differences.push_back("--region");
  }
  if (film.max_depth() != job.max_depth() || film.auto_depth() != job.auto_depth()) {
    differences.push_back(absl::StrCat("--max-depth (the film's is ", film.max_depth(), ")"));
  }
  if (film.seed() != job.seed()) {
    differences.push_back(absl::StrCat("--seed (the film's is ", film.seed(), ")"));
  }
  if (film.feature_spp() != job.feature_spp()) {
    differences.push_back(absl::StrCat("--feature-spp (the film's is ", film.feature_spp(), ")"));
  }
  if (film.isa() != job.isa()) differences.push_back("--isa");
  if (film.arithmetic() != job.arithmetic()) differences.push_back("--arithmetic");
  if (film.transparent() != job.transparent()) differences.push_back("--transparent");
  if (differences.empty()) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat(flag, ": the film was rendered with other settings: ",
                   absl::StrJoin(differences, ", "),
                   "; repeat the film's, or leave the flags away to take them from it"));
}

}  // namespace tessera
