// The bounds of everything that outside data can drive (C6).
#pragma once

#include <cstddef>
#include <cstdint>

#include "core/film/tile_statistics.h"

namespace tessera {

inline constexpr int kFrameSideMaxPx = 1 << 16;
inline constexpr int64_t kFramePixelsMax = int64_t{1} << 28;
inline constexpr int64_t kSppMax = int64_t{1} << 30;
inline constexpr int kMaxDepthMax = 1024;
inline constexpr int kPriorityMax = 1000000;
inline constexpr int64_t kFilmBytesPerPixel =
    int64_t{kNumHalves} * (int{kNumFloatPlanes} + int{kNumCountPlanes}) * int64_t{sizeof(float)};
// A delta of one tile must stay below 1 MiB.
inline constexpr int kTileSizeMaxPx = 64;
static_assert(kTileSizeMaxPx * kTileSizeMaxPx * kFilmBytesPerPixel < 1 << 20);
// The largest frame in tiles of 32 pixels. Bounds a job's tables and its record of sample counts.
inline constexpr int64_t kTilesMax = int64_t{1} << 18;
inline constexpr int kAssetsMax = 65536;
inline constexpr int64_t kAssetBytesMax = int64_t{1} << 46;  // 64 TiB; the sum fits an int64
inline constexpr int kNameBytesMax = 4096;
inline constexpr int kRequestIdBytesMax = 128;
inline constexpr int kErrorBytesMax = 4096;
inline constexpr int kSceneNotesMax = 256;
inline constexpr int kSceneMaterialsMax = 65536;

inline constexpr int kJobsMax = 10000;
inline constexpr int kRequestIdsMax = 4 * kJobsMax;
inline constexpr int kWorkersMax = 4096;
inline constexpr int kHostBytesMax = 255;  // RFC 1035
inline constexpr int kWorkerThreadsMax = 1024;
inline constexpr int64_t kRaysPerSampleMax = 1 << 20;

// One lease: about two seconds of one thread at half a million samples a second. Slower ones get
// less (CoordinatorConfig::lease_target_ms).
inline constexpr int64_t kLeaseSamplesMax = int64_t{1} << 20;
// How many passes over the frame may be under way at once, and units of one tile, about; both bound
// the film's waiting nodes (kWaitingNodesMax).
inline constexpr int kOpenStagesMax = 8;
inline constexpr int64_t kOpenUnitsOfTileMax = 128;

// A window that is leased to be filtered, and its planes with a halo of at most 128 pixels.
inline constexpr int64_t kFilterWindowPixelsMax = 256 * 256;
inline constexpr int64_t kFilterInputPixelsMax = 512 * 512;
inline constexpr size_t kFilterLeasesMax = 1024;  // of all workers
// Of one job, units that wait for a second host's samples; then no others are handed out.
inline constexpr size_t kAuditsMax = 4096;
// Hosts that render a unit before it is clear that no two of them agree.
inline constexpr size_t kTestimoniesMax = 7;
inline constexpr int kCrashesMax = 16;  // that one worker reports
inline constexpr int kCrashUnitsMax = kWorkerThreadsMax;  // that one crash may be blamed on
inline constexpr size_t kBannedHostsMax = 4096;

inline constexpr int kStreamsOfConnectionMax = 1024;  // more wait at the client
inline constexpr int kWatchesMax = 4096;
// Pictures and films on their way to clients hold copies in memory.
inline constexpr int kImageStreamsMax = 64;
inline constexpr int64_t kImageStreamBytesMax = int64_t{1} << 30;
inline constexpr int kFilmStreamsMax = 16;
inline constexpr int64_t kFilmStreamBytesMax = int64_t{2} << 30;

inline constexpr int kMessageBytesMax = 4 << 20;  // that the server receives
// A job's settings travel in every Job and to every worker, whose messages have the same bound.
inline constexpr int kSettingsBytesMax = 1 << 20;
inline constexpr int kChunkBytesMax = 1 << 20;    // of one streamed message
inline constexpr int kListPageMax = 1000;
inline constexpr int kListPageBytesMax = 1 << 20;  // a page with a single job may be larger

}  // namespace tessera
