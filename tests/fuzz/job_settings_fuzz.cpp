// What clients ask for. Input: a serialised tessera.v1.JobSettings.
#include <google/protobuf/stubs/logging.h>
#include <google/protobuf/util/message_differencer.h>

#include <cstdlib>

#include "server/coordinator/job_settings.h"
#include "tests/fuzz/fuzz_target.h"
#include "tests/server/simulated_farm.h"

namespace tessera {
namespace {

const SettingsDefaults kDefaults{.tile_size = 32, .denoisers = {"regression", "none"}};
constexpr int64_t kPixelsMax = 1 << 16;  // above, no film is made: a fuzzer's memory is small

absl::StatusOr<v1::JobSettings> Complete(std::string_view input) {
  v1::JobSettings settings;
  if (!settings.ParseFromArray(input.data(), static_cast<int>(input.size()))) {
    return absl::InvalidArgumentError("no message");
  }
  return CompleteSettings(std::move(settings), kDefaults);
}

}  // namespace

bool IsTaken(std::string_view input) { return Complete(input).ok(); }

void FuzzOne(std::string_view input) {
  const absl::StatusOr<v1::JobSettings> settings = Complete(input);
  if (!settings.ok()) return;
  // What is complete stays as it is, and a coordinator can run it.
  const absl::StatusOr<v1::JobSettings> again = CompleteSettings(*settings, kDefaults);
  if (!again.ok() || !google::protobuf::util::MessageDifferencer::Equivalent(*settings, *again)) {
    std::abort();
  }
  if (RegionOf(*settings).area() > kPixelsMax) return;
  CoordinatorConfig config = SmallConfig();
  config.defaults = kDefaults;
  SimulatedFarm farm(config);
  const StepResult created = farm.Post(CreateJobEvent{.settings = *settings});
  if (!created.status.ok()) return;
  farm.Connect();
  if (!farm.Command(JobCommand::kPause, created.job).ok() ||
      !farm.Command(JobCommand::kCancel, created.job).ok()) {
    std::abort();
  }
}

std::vector<std::string> FuzzSeeds() {
  google::protobuf::SetLogHandler(nullptr);  // what is no UTF-8 is no news here
  v1::JobSettings plain = SmallSettings();
  v1::JobSettings full = SmallSettings(64);
  *full.mutable_region() = RegionProto({2, 3, 10, 9});
  full.set_target_error(0.02);
  full.set_target_tile_error(0.05);
  full.mutable_max_time()->set_seconds(60);
  full.set_denoiser("none");
  full.set_quality(v1::QUALITY_PREVIEW);
  full.set_isa("x86-64-v2");
  full.set_priority(3);
  full.set_seed(17);
  return {plain.SerializeAsString(), full.SerializeAsString()};
}

}  // namespace tessera
