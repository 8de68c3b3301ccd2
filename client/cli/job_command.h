// What the commands about jobs on a server share.
#pragma once

#include <functional>
#include <memory>
#include <string>

#include <nlohmann/json_fwd.hpp>

#include "absl/status/statusor.h"
#include "client/cli/flags.h"
#include "client/farm_client.h"

namespace tessera {

// Errors: as Connect.
absl::StatusOr<std::unique_ptr<FarmClient>> ConnectToFarm(const ConnectFlags& flags);

// One JSON object and a newline on stdout.
void PrintJson(const nlohmann::ordered_json& json);

// Steers the job that the flags name and prints its state.
absl::Status SteerJob(
    const JobFlags& flags,
    const std::function<absl::StatusOr<v1::Job>(FarmClient&, const std::string& name)>& steer);

// CANCELLED, or what made the job fail; OK for a job that is done.
absl::Status OutcomeOf(const v1::Job& job);

}  // namespace tessera
