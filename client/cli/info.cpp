// tessera info SCENE: what a scene needs.
#include <cstdio>

#include <nlohmann/json.hpp>

#include "absl/status/statusor.h"
#include "client/cli/commands.h"
#include "client/cli/job_command.h"

namespace tessera {
namespace {

using nlohmann::ordered_json;

std::string ValueText(const ordered_json& value) {
  if (value.is_null()) return "unknown";
  if (value.is_boolean()) return value.get<bool>() ? "yes" : "no";
  return value.is_string() ? value.get<std::string>()
                           : value.dump(-1, ' ', false, ordered_json::error_handler_t::replace);
}

// "key  value"; a list of words takes a line for each.
void PrintMember(const std::string& key, const ordered_json& value) {
  if (!value.is_array() || (!value.empty() && value.front().is_number())) {
    std::printf("%-24s %s\n", key.c_str(), ValueText(value).c_str());
    return;
  }
  if (value.empty()) std::printf("%-24s none\n", key.c_str());
  for (const ordered_json& entry : value) {
    std::printf("%-24s %s\n", key.c_str(), ValueText(entry).c_str());
  }
}

}  // namespace

absl::Status RunInfo(const InfoFlags& flags, const CommandLineParts& parts) {
  const absl::StatusOr<SceneDescription> description = parts.describe_scene(flags.scene);
  if (!description.ok()) return description.status();
  if (flags.json) {
    PrintJson(description->members);
  } else {
    for (const auto& [key, value] : description->members.items()) {
      if (key != "error") PrintMember(key, value);  // goes to stderr
    }
    std::fflush(stdout);
  }
  return description->renderable;
}

}  // namespace tessera
