// Jobs and workers as words and as JSON.
#pragma once

#include <string>

#include <nlohmann/json_fwd.hpp>

#include "tessera/v1/job.pb.h"
#include "tessera/v1/worker.pb.h"

namespace tessera {

std::string StateWord(v1::JobState state);         // "running"
std::string StopWord(v1::StopReason stop_reason);  // "target_error"; empty if none
// 64 hexadecimal digits; empty without a digest.
std::string DigestText(const v1::Job& job);

nlohmann::ordered_json JobJson(const v1::Job& job);
nlohmann::ordered_json WorkerJson(const v1::Worker& worker);

// One line of `tessera list`, and its heading.
std::string JobRow(const v1::Job& job);
std::string JobRowHeading();
std::string WorkerRow(const v1::Worker& worker);
std::string WorkerRowHeading();
// Several lines: `tessera show`.
std::string JobDetails(const v1::Job& job);

}  // namespace tessera
