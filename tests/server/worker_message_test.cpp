#include "server/coordinator/worker_message.h"

#include <gtest/gtest.h>

#include <string>
#include <utility>
#include <vector>

#include "server/coordinator/coordinator.h"
#include "server/coordinator/job_settings.h"
#include "tests/server/synthetic_tile.h"

namespace tessera {
namespace {

constexpr PixelRect kWindow{0, 0, 8, 8};
constexpr SampleRange kRange{4, 8};
constexpr SessionId kSession = 5;

v1::WorkerMessage DeltaMessage() {
  v1::WorkerMessage message;
  v1::TileDelta& delta = *message.mutable_delta();
  delta.set_lease_id(300);
  delta.set_job("jobs/1");
  delta.set_tile_index(7);
  *delta.mutable_window() = RegionProto(kWindow);
  delta.set_sample_begin(kRange.begin);
  delta.set_sample_end(kRange.end);
  delta.set_feature_end(kAllFeatures);
  delta.set_rays(1234);
  delta.set_encoding(static_cast<uint32_t>(DeltaEncoding::kPackedBlocks));
  delta.set_payload(
      EncodeDelta(SyntheticTile(1, kWindow, kRange), DeltaEncoding::kPackedBlocks).payload);
  delta.set_checksum(DeltaChecksum(KeyOf(delta), delta.payload()));
  return message;
}

TEST(WorkerMessage, ADeltaInBytesIsTheDeltaInMemory) {
  v1::WorkerMessage message = DeltaMessage();
  const std::string bytes = message.SerializeAsString();
  const absl::StatusOr<Event> from_bytes = EventOf(kSession, bytes, true);
  const absl::StatusOr<Event> from_memory = EventOf(kSession, message, true);
  ASSERT_TRUE(from_bytes.ok() && from_memory.ok()) << from_bytes.status() << from_memory.status();
  const auto& a = std::get<DeltaEvent>(*from_bytes);
  const auto& b = std::get<DeltaEvent>(*from_memory);
  EXPECT_EQ(a.session, kSession);
  EXPECT_EQ(a.tile, SyntheticTile(1, kWindow, kRange));
  EXPECT_EQ(a.tile, b.tile);
  EXPECT_EQ(a.delta.SerializeAsString(), b.delta.SerializeAsString());
  EXPECT_EQ(a.delta.rays(), 1234);
  EXPECT_TRUE(a.delta.payload().empty());
  EXPECT_EQ(a.wire_bytes, b.wire_bytes);
  EXPECT_EQ(a.noise, b.noise);
  EXPECT_EQ(a.digest, b.digest);
}

// What it will be folded into is asked for once it is known to be undamaged.
TEST(WorkerMessage, ADeltaAsksForItsTarget) {
  const v1::WorkerMessage message = DeltaMessage();
  const std::pair key{message.delta().tile_index(), kRange};
  std::vector<std::pair<int64_t, SampleRange>> asked;
  const FindFoldTarget find = [&](JobId job, int64_t tile_index, SampleRange range) {
    EXPECT_EQ(JobName(job), message.delta().job());
    asked.push_back({tile_index, range});
    return FoldTarget{};
  };
  std::string bytes = message.SerializeAsString();
  ASSERT_TRUE(EventOf(kSession, bytes, false, find).ok());
  EXPECT_EQ(asked, std::vector{key});
  bytes.back() ^= 1;
  EXPECT_FALSE(EventOf(kSession, bytes, false, find).ok());
  EXPECT_EQ(asked.size(), 1u);
}

TEST(WorkerMessage, OtherMessagesInBytesAreThemselves) {
  v1::WorkerMessage message;
  message.mutable_heartbeat()->add_leases()->set_id(9);
  const absl::StatusOr<Event> event = EventOf(kSession, message.SerializeAsString());
  ASSERT_TRUE(event.ok());
  EXPECT_EQ(std::get<HeartbeatEvent>(*event).leases.at(0).id(), 9);
}

// Whatever is cut off or changed: the message is refused. The checksums see to the values, the
// parser to the rest.
TEST(WorkerMessage, DamagedBytesAreRefused) {
  const std::string bytes = DeltaMessage().SerializeAsString();
  for (size_t size = 0; size < bytes.size(); ++size) {
    EXPECT_FALSE(EventOf(kSession, std::string_view(bytes).substr(0, size)).ok()) << size;
  }
  for (size_t i = 0; i < bytes.size(); i += 3) {
    std::string damaged = bytes;
    damaged[i] = static_cast<char>(damaged[i] ^ 0x10);
    const absl::StatusOr<Event> event = EventOf(kSession, damaged);
    if (!event.ok()) continue;
    // Fields that no checksum binds: how long it took, how large it was.
    const auto* const delta = std::get_if<DeltaEvent>(&*event);
    ASSERT_NE(delta, nullptr) << i;
    EXPECT_EQ(delta->tile, SyntheticTile(1, kWindow, kRange)) << i;
  }
}

// As a parser of messages does: the last of a field counts, wherever it stands.
TEST(WorkerMessage, TheLastPayloadCounts) {
  const std::string delta = DeltaMessage().delta().SerializeAsString();
  v1::TileDelta other;
  other.set_payload("something else");
  const std::string bytes = other.SerializeAsString() + delta;
  std::string envelope;
  envelope.push_back(static_cast<char>(v1::WorkerMessage::kDeltaFieldNumber << 3 | 2));
  for (size_t size = bytes.size();; size >>= 7) {
    envelope.push_back(static_cast<char>((size & 0x7f) | (size >= 0x80 ? 0x80 : 0)));
    if (size < 0x80) break;
  }
  EXPECT_TRUE(EventOf(kSession, envelope + bytes).ok());
}

}  // namespace
}  // namespace tessera
