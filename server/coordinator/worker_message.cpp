#include "server/coordinator/worker_message.h"

#include <utility>

#include "core/denoise/window_codec.h"
#include "core/film/delta_codec.h"
#include "server/coordinator/job_settings.h"
#include "server/coordinator/limits.h"
#include "server/coordinator/tile_noise.h"

namespace tessera {
namespace {

absl::StatusOr<Event> DecodeEvent(SessionId session, v1::TileDelta& delta, bool with_digest) {
  const v1::Region& window = delta.window();
  const SampleRange range{delta.sample_begin(), delta.sample_end()};
  if (window.width() < 1 || window.height() < 1 || window.width() > kTileSizeMaxPx ||
      window.height() > kTileSizeMaxPx || window.x() < 0 || window.y() < 0 ||
      window.x() > kFrameSideMaxPx || window.y() > kFrameSideMaxPx) {
    return absl::InvalidArgumentError("delta: window is impossible");
  }
  if (range.begin < 0 || range.end > kSppMax || !range.IsNode()) {
    return absl::InvalidArgumentError("delta: the sample range is no aligned power of two");
  }
  if (delta.checksum() != DeltaChecksum(KeyOf(delta), delta.payload())) {
    return absl::InvalidArgumentError("delta: wrong checksum, it was damaged on its way");
  }
  DeltaEvent event{.session = session};
  event.wire_bytes = static_cast<int64_t>(delta.ByteSizeLong());
  absl::StatusOr<TileStatistics> tile =
      DecodeDelta(RectOf(window), range, delta.feature_end(), delta.encoding(), delta.payload());
  if (!tile.ok()) return tile.status();
  event.tile = *std::move(tile);
  event.noise = NoiseOf(event.tile);
  if (with_digest) event.digest = TestimonyOf(event.tile);
  delta.clear_payload();
  event.delta = std::move(delta);
  return event;
}

absl::StatusOr<Event> DecodeEvent(SessionId session, v1::FilteredWindow& filtered) {
  const v1::Region& w = filtered.window();
  if (w.width() < 1 || w.height() < 1 || w.x() < 0 || w.y() < 0 || w.x() > kFrameSideMaxPx ||
      w.y() > kFrameSideMaxPx || int64_t{w.width()} * w.height() > kFilterWindowPixelsMax) {
    return absl::InvalidArgumentError("filtered: window is impossible");
  }
  const FilteredKey key{filtered.lease_id(), filtered.job(), filtered.revision(), RectOf(w)};
  if (filtered.checksum() != FilteredChecksum(key, filtered.payload())) {
    return absl::InvalidArgumentError("filtered: wrong checksum, it was damaged on its way");
  }
  absl::StatusOr<FilteredPlanes> planes = DecodeFiltered(RectOf(w), filtered.payload());
  if (!planes.ok()) return planes.status();
  FilteredEvent event{.session = session};
  event.wire_bytes = static_cast<int64_t>(filtered.ByteSizeLong());
  event.planes = std::make_shared<const FilteredPlanes>(*std::move(planes));
  filtered.clear_payload();
  event.filtered = std::move(filtered);
  return event;
}

}  // namespace

DeltaKey KeyOf(const v1::TileDelta& delta) {
  return {.lease_id = delta.lease_id(),
          .job = delta.job(),
          .tile_index = delta.tile_index(),
          .window = RectOf(delta.window()),
          .range = {delta.sample_begin(), delta.sample_end()},
          .feature_end = delta.feature_end(),
          .rays = delta.rays(),
          .max_depth = delta.max_depth()};
}

Sha256Digest TestimonyOf(const TileStatistics& tile) {
  return Sha256Of(EncodeDelta(tile, DeltaEncoding::kPacked).payload);
}

absl::StatusOr<Event> EventOf(SessionId session, v1::WorkerMessage& message, bool with_digests) {
  switch (message.message_case()) {
    case v1::WorkerMessage::kHello:
      return WorkerConnectedEvent{session, std::move(*message.mutable_hello())};
    case v1::WorkerMessage::kDelta:
      return DecodeEvent(session, *message.mutable_delta(), with_digests);
    case v1::WorkerMessage::kHeartbeat:
      return HeartbeatEvent{
          session, {message.heartbeat().leases().begin(), message.heartbeat().leases().end()}};
    case v1::WorkerMessage::kDecline:
      return DeclineEvent{session, std::move(*message.mutable_decline())};
    case v1::WorkerMessage::kSceneReady:
      return SceneReadyEvent{session, std::move(*message.mutable_scene_ready())};
    case v1::WorkerMessage::kSceneFailure:
      return SceneFailureEvent{session, std::move(*message.mutable_scene_failure())};
    case v1::WorkerMessage::kDrain:
      return DrainEvent{session};
    case v1::WorkerMessage::kFiltered:
      return DecodeEvent(session, *message.mutable_filtered());
    case v1::WorkerMessage::MESSAGE_NOT_SET:
      break;
  }
  return absl::InvalidArgumentError("an empty message, or one of another version");
}

}  // namespace tessera
