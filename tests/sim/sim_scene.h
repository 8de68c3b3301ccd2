// What the simulated workers render: a pure function of (settings, tile, range) that yields real
// statistics in real bytes, and the pictures that one process alone would make of it.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "core/base/tile_grid.h"
#include "core/denoise/denoiser.h"
#include "server/coordinator/event.h"
#include "tessera/v1/job.pb.h"
#include "tessera/v1/worker.pb.h"

namespace tessera {

inline constexpr int64_t kSimSceneBytes = int64_t{64} << 20;
inline constexpr char kSimAsset[] = "a scene";

v1::AssetRef SimAsset();

// Whoever renders sample 0 of tile 1 of a job with this seed crashes.
inline constexpr uint64_t kPoisonSeed = 666;

// The depth that a job's paths have, in an arithmetic: its own number, or what its pilot finds.
int SimDepth(const v1::JobSettings& settings, const std::string& arithmetic);

// The delta of a lease, as an honest worker makes it, or one of many that lie, each in its own way.
v1::TileDelta SimRender(const v1::JobSettings& settings, const v1::Lease& lease,
                        const std::string& arithmetic, int lie = 0);

// A window of a job's picture, as the server offers it, its planes, and what an honest filter makes
// of them.
struct SimWindow {
  v1::FilterLease lease;  // all but its id
  std::string input;
  FilteredPlanes filtered;
};
SimWindow MakeSimWindow(JobId job, uint64_t number);
// The answer of an honest worker, or of one that lies.
absl::StatusOr<v1::FilteredWindow> SimFilter(const v1::FilterLease& lease,
                                             const std::string& input, bool is_lie);

// The digest of a film whose tile i has its first counts[i] samples, all in one arithmetic.
std::string ReferenceDigest(const v1::JobSettings& settings, const std::vector<int64_t>& counts,
                            const std::string& arithmetic);

// What the server's filter would estimate of a picture whose tiles have so many samples: by tile
// (CellState::error), and of the whole.
std::vector<double> SimTileErrors(const TileGrid& grid, const std::vector<int64_t>& samples);
double SimError(const TileGrid& grid, const std::vector<double>& tile_errors);

}  // namespace tessera
