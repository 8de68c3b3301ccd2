// What workers say, as events of the coordinator: checks and decodes bytes from outside.
#pragma once

#include <functional>
#include <string_view>

#include "absl/status/statusor.h"
#include "core/film/delta_codec.h"
#include "core/film/fold_target.h"
#include "server/coordinator/event.h"
#include "tessera/v1/worker.pb.h"

namespace tessera {

// The event that a message of an open session stands for; takes what it needs out of `message`.
// Errors: INVALID_ARGUMENT for what no worker of this version sends, damaged bytes included: the
// session must end.
// with_digests: deltas come with DeltaEvent.digest, which takes time.
absl::StatusOr<Event> EventOf(SessionId session, v1::WorkerMessage& message,
                              bool with_digests = false);

// Where the delta of a tile's sample range will be folded in, as far as that is known.
using FindFoldTarget = std::function<FoldTarget(JobId job, int64_t tile_index, SampleRange range)>;

// The same of a v1::WorkerMessage as it came over the wire: a delta's payload is read where it
// lies. find_target: may be empty.
absl::StatusOr<Event> EventOf(SessionId session, std::string_view message,
                              bool with_digests = false, const FindFoldTarget& find_target = {});

// What the checksum of a delta binds its payload to. Valid as long as `delta`.
DeltaKey KeyOf(const v1::TileDelta& delta);

// What an audit compares: the SHA-256 of every bit of the statistics.
Sha256Digest TestimonyOf(const TileStatistics& tile);

}  // namespace tessera
