// Flags of programs as environment variables.
#pragma once

#include <cctype>
#include <string>

namespace tessera {

// ("tessera-server", "data-dir") is "TESSERA_SERVER_DATA_DIR".
inline std::string EnvironmentName(const std::string& program, const std::string& flag) {
  std::string name = program + "_" + flag;
  for (char& c : name) {
    c = c == '-' ? '_' : static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
  }
  return name;
}

// Lets each flag of a CLI::App be given by its variable too; the command line wins.
template <typename App>
void ReadFlagsFromEnvironment(App& app) {
  for (auto* option : app.get_options()) {
    if (!option->get_lnames().empty() && option->get_configurable()) {
      option->envname(EnvironmentName(app.get_name(), option->get_lnames().front()));
    }
  }
}

}  // namespace tessera
