#include "server/event_log.h"

#include <sstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <spdlog/sinks/ostream_sink.h>

#include "server/log.h"

namespace tessera {
namespace {

SendEffect Granted() {
  SendEffect effect{3, {}};
  v1::Lease& lease = *effect.message.mutable_lease();
  lease.set_id(12);
  lease.set_job("jobs/7");
  lease.set_tile_index(4);
  lease.set_sample_begin(16);
  lease.set_sample_end(32);
  return effect;
}

DeltaEvent Delivered() {
  DeltaEvent event{.session = 3};
  event.delta.set_lease_id(12);
  event.delta.set_job("jobs/7");
  event.delta.set_tile_index(4);
  event.delta.set_sample_begin(16);
  event.delta.set_sample_end(32);
  event.wire_bytes = 500;
  return event;
}

// Everything that `log` writes at a level.
template <typename Function>
std::string Written(spdlog::level::level_enum level, const Function& log) {
  std::ostringstream text;
  const auto sinks = ServerLog().sinks();
  const auto before = ServerLog().level();
  auto sink = std::make_shared<spdlog::sinks::ostream_sink_mt>(text);
  sink->set_pattern("%l %v");
  ServerLog().sinks() = {sink};
  ServerLog().set_level(level);
  log();
  ServerLog().sinks() = sinks;
  ServerLog().set_level(before);
  return text.str();
}

TEST(EventLog, LinesNameSessionJobLeaseTileAndSamples) {
  EXPECT_EQ(LineOf(Granted()), "session=3 job=7 lease=12 tile=4 samples=16..32 granted");
  EXPECT_EQ(LineOf(Delivered()), "session=3 job=7 lease=12 tile=4 samples=16..32 bytes=500");
  SendEffect revoked{3, {}};
  revoked.message.mutable_revoke()->set_id(12);
  EXPECT_EQ(LineOf(revoked), "session=3 lease=12 revoked");
  SendEffect welcome{3, {}};
  welcome.message.mutable_welcome();
  EXPECT_EQ(LineOf(welcome), "");
}

TEST(EventLog, WhatAPersonOnCallLooksForHasALine) {
  const Unit unit{4, {16, 32}};
  EXPECT_EQ(LineOf(LeaseExpiredEffect{3, 2, 7, 12, unit}),
            "session=3 worker=2 job=7 lease=12 tile=4 samples=16..32 expired");
  EXPECT_EQ(LineOf(RaceBegunEffect{3, 2, 7, 12, unit, 11, 1}),
            "session=3 worker=2 job=7 lease=12 tile=4 samples=16..32 races lease=11 worker=1");
  EXPECT_EQ(LineOf(AuditDiffersEffect{7, unit, "b", "a"}),
            "job=7 tile=4 samples=16..32 host=b differs from host=a");
  const auto log = [&] { LogRace(RaceBegunEffect{3, 2, 7, 12, unit, 11, 1}); };
  EXPECT_NE(Written(spdlog::level::debug, log), "");
  EXPECT_EQ(Written(spdlog::level::info, log), "");
}

TEST(EventLog, LeasesAreLoggedByVerboseServersOnly) {
  const auto log = [] {
    LogSent(Granted());
    LogDelta("lease=12", absl::OkStatus());
    LogDelta("lease=13", absl::AlreadyExistsError("covered"));
  };
  EXPECT_EQ(Written(spdlog::level::debug, log),
            "debug session=3 job=7 lease=12 tile=4 samples=16..32 granted\n"
            "debug lease=12 taken in\n"
            "debug lease=13 refused: covered\n");
  EXPECT_EQ(Written(spdlog::level::info, log), "");
}

}  // namespace
}  // namespace tessera
