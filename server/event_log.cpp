#include "server/event_log.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "server/log.h"

namespace tessera {
namespace {

// "jobs/7" is "7": lines of the log say job=7.
absl::string_view NumberOf(absl::string_view name) { return absl::StripPrefix(name, "jobs/"); }

std::string TextOf(const Unit& unit) {
  return absl::StrCat("tile=", unit.tile, " samples=", unit.range.begin, "..", unit.range.end);
}

}  // namespace

std::string LineOf(const SendEffect& effect) {
  const v1::CoordinatorMessage& message = effect.message;
  if (message.has_lease()) {
    const v1::Lease& lease = message.lease();
    return absl::StrCat("session=", effect.session, " job=", NumberOf(lease.job()),
                        " lease=", lease.id(), " tile=", lease.tile_index(),
                        " samples=", lease.sample_begin(), "..", lease.sample_end(), " granted");
  }
  if (message.has_filter()) {
    const v1::FilterLease& lease = message.filter();
    const v1::Region& window = lease.window();
    return absl::StrCat("session=", effect.session, " job=", NumberOf(lease.job()),
                        " lease=", lease.id(), " window=", window.x(), ",", window.y(), ",",
                        window.width(), ",", window.height(), " granted");
  }
  if (message.has_revoke()) {
    return absl::StrCat("session=", effect.session, " lease=", message.revoke().id(), " revoked");
  }
  return {};
}

std::string LineOf(const DeltaEvent& event) {
  const v1::TileDelta& delta = event.delta;
  return absl::StrCat("session=", event.session, " job=", NumberOf(delta.job()),
                      " lease=", delta.lease_id(), " tile=", delta.tile_index(),
                      " samples=", delta.sample_begin(), "..", delta.sample_end(),
                      " bytes=", event.wire_bytes);
}

std::string LineOf(const LeaseExpiredEffect& effect) {
  return absl::StrCat("session=", effect.session, " worker=", effect.worker, " job=", effect.job,
                      " lease=", effect.lease, " ", TextOf(effect.unit), " expired");
}

std::string LineOf(const RaceBegunEffect& effect) {
  return absl::StrCat("session=", effect.session, " worker=", effect.worker, " job=", effect.job,
                      " lease=", effect.lease, " ", TextOf(effect.unit), " races lease=",
                      effect.slow, " worker=", effect.other);
}

std::string LineOf(const AuditDiffersEffect& effect) {
  return absl::StrCat("job=", effect.job, " ", TextOf(effect.unit), " host=", effect.host,
                      " differs from host=", effect.other);
}

void LogSent(const SendEffect& effect) {
  if (!ServerLog().should_log(spdlog::level::debug)) return;
  if (const std::string line = LineOf(effect); !line.empty()) ServerLog().debug("{}", line);
}

void LogRace(const RaceBegunEffect& effect) {
  if (ServerLog().should_log(spdlog::level::debug)) ServerLog().debug("{}", LineOf(effect));
}

void LogDelta(const std::string& line, const absl::Status& taken_in) {
  if (taken_in.ok()) {
    ServerLog().debug("{} taken in", line);
  } else {
    ServerLog().debug("{} refused: {}", line, std::string(taken_in.message()));
  }
}

}  // namespace tessera
