// JobSettings from flags, and whether a film belongs to them.
#pragma once

#include "absl/status/statusor.h"
#include "client/asset_collection.h"
#include "client/cli/flags.h"
#include "tessera/v1/job.pb.h"

namespace tessera {

inline constexpr int64_t kSppDefault = 64;
inline constexpr int64_t kSppMax = int64_t{1} << 30;
// With --target-error or --max-time and no --spp.
inline constexpr int64_t kSppOpenEnded = int64_t{1} << 16;

// Everything but scene_name, assets and environment.map_name, which SetAssets adds.
// `film`: the settings that flags which are not given fall back to (--continue, --replay); null =
// defaults.
// Errors: INVALID_ARGUMENT naming flag, value and remedy.
absl::StatusOr<v1::JobSettings> SettingsFromFlags(const SceneFlags& flags,
                                                  const v1::JobSettings* film);

void SetAssets(const SceneAssets& assets, v1::JobSettings* settings);

// Whether samples of a film with settings `film` are the first samples of a job with `job`: all
// that decides the bits must be equal; spp, stops and how the picture is served may differ.
// `flag`: --continue or --replay, which named the film.
// Errors: INVALID_ARGUMENT listing what differs.
absl::Status CheckContinues(const std::string& flag, const v1::JobSettings& film,
                            const v1::JobSettings& job);

}  // namespace tessera
