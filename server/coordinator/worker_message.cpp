#include "server/coordinator/worker_message.h"

#include <google/protobuf/io/coded_stream.h>
#include <google/protobuf/wire_format_lite.h>

#include <optional>
#include <string>
#include <utility>

#include "core/denoise/window_codec.h"
#include "core/film/delta_codec.h"
#include "server/coordinator/coordinator.h"
#include "server/coordinator/job_settings.h"
#include "server/coordinator/limits.h"
#include "server/coordinator/tile_noise.h"

namespace tessera {
namespace {

using google::protobuf::internal::WireFormatLite;
using google::protobuf::io::CodedInputStream;

constexpr uint32_t kDeltaTag = WireFormatLite::MakeTag(v1::WorkerMessage::kDeltaFieldNumber,
                                                       WireFormatLite::WIRETYPE_LENGTH_DELIMITED);
constexpr uint32_t kPayloadTag = WireFormatLite::MakeTag(
    v1::TileDelta::kPayloadFieldNumber, WireFormatLite::WIRETYPE_LENGTH_DELIMITED);

// A delta without its payload, which lies in the bytes that it was read from.
struct WireDelta {
  v1::TileDelta delta;
  std::string_view payload;
  int64_t wire_bytes = 0;
};

CodedInputStream StreamOf(std::string_view bytes) {
  return CodedInputStream(reinterpret_cast<const uint8_t*>(bytes.data()),
                          static_cast<int>(bytes.size()));
}

// What a v1::WorkerMessage holds that is a delta and nothing else; nullopt for others.
std::optional<std::string_view> DeltaBytesOf(std::string_view message) {
  CodedInputStream stream = StreamOf(message);
  uint32_t size = 0;
  if (stream.ReadTag() != kDeltaTag || !stream.ReadVarint32(&size)) return std::nullopt;
  const auto begin = static_cast<size_t>(stream.CurrentPosition());
  if (message.size() - begin != size) return std::nullopt;
  return message.substr(begin);
}

// The bytes of a v1::TileDelta, taken apart. Not copying the payload is what this is for.
std::optional<WireDelta> ReadDelta(std::string_view bytes) {
  WireDelta out;
  out.wire_bytes = static_cast<int64_t>(bytes.size());
  std::string others;
  CodedInputStream stream = StreamOf(bytes);
  for (;;) {
    const auto field_begin = static_cast<size_t>(stream.CurrentPosition());
    if (field_begin == bytes.size()) break;
    const uint32_t tag = stream.ReadTag();
    if (tag == 0 || !WireFormatLite::SkipField(&stream, tag)) return std::nullopt;
    const auto field_end = static_cast<size_t>(stream.CurrentPosition());
    const std::string_view field = bytes.substr(field_begin, field_end - field_begin);
    if (tag != kPayloadTag) {
      others += field;
      continue;
    }
    CodedInputStream payload = StreamOf(field);
    uint32_t size = 0;
    payload.ReadTag();
    if (!payload.ReadVarint32(&size) || size > field.size()) return std::nullopt;
    out.payload = field.substr(field.size() - size);
  }
  if (!out.delta.ParseFromString(others)) return std::nullopt;
  return out;
}

absl::StatusOr<Event> DecodeEvent(SessionId session, WireDelta&& wire, bool with_digest,
                                  const FindFoldTarget& find_target) {
  v1::TileDelta& delta = wire.delta;
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
  if (delta.checksum() != DeltaChecksum(KeyOf(delta), wire.payload)) {
    return absl::InvalidArgumentError("delta: wrong checksum, it was damaged on its way");
  }
  DeltaEvent event{.session = session};
  event.wire_bytes = wire.wire_bytes;
  FoldTarget target;
  if (const absl::StatusOr<JobId> job = ParseJobName(delta.job()); job.ok() && find_target) {
    target = find_target(*job, delta.tile_index(), range);
  }
  absl::StatusOr<TileStatistics> tile = DecodeDelta(
      RectOf(window), range, delta.feature_end(), delta.encoding(), wire.payload, &target);
  if (!tile.ok()) return tile.status();
  event.tile = *std::move(tile);
  event.noise = NoiseOf(event.tile);
  if (with_digest) event.digest = TestimonyOf(event.tile);
  event.delta = std::move(delta);
  return event;
}

// Of a message in memory: its payload stays alive until it is decoded.
absl::StatusOr<Event> DecodeEvent(SessionId session, v1::TileDelta& delta, bool with_digest) {
  const auto wire_bytes = static_cast<int64_t>(delta.ByteSizeLong());
  const std::string payload = std::move(*delta.mutable_payload());
  delta.clear_payload();
  return DecodeEvent(session, {std::move(delta), payload, wire_bytes}, with_digest, {});
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

absl::StatusOr<Event> EventOf(SessionId session, std::string_view message, bool with_digests,
                              const FindFoldTarget& find_target) {
  if (const std::optional<std::string_view> bytes = DeltaBytesOf(message)) {
    std::optional<WireDelta> delta = ReadDelta(*bytes);
    if (!delta) return absl::InvalidArgumentError("a damaged message, or one of another version");
    return DecodeEvent(session, *std::move(delta), with_digests, find_target);
  }
  v1::WorkerMessage parsed;
  if (!parsed.ParseFromArray(message.data(), static_cast<int>(message.size()))) {
    return absl::InvalidArgumentError("a damaged message, or one of another version");
  }
  return EventOf(session, parsed, with_digests);
}

}  // namespace tessera
