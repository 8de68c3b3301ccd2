// tessera chart SCENE... -o DIR: hands over to the program tessera-chart.
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <string>
#include <system_error>
#include <vector>

#include "absl/strings/str_cat.h"
#include "client/cli/commands.h"

namespace tessera {

absl::Status RunChart(const std::vector<std::string>& arguments) {
  std::error_code error;
  const std::filesystem::path self = std::filesystem::read_symlink("/proc/self/exe", error);
  if (error) {
    return absl::InternalError(absl::StrCat("/proc/self/exe cannot be read: ", error.message()));
  }
  const std::string program = self.parent_path() / "tessera-chart";
  std::vector<char*> argv = {const_cast<char*>(program.c_str())};
  for (const std::string& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
  argv.push_back(nullptr);
  setenv("TESSERA", self.c_str(), 1);
  execv(program.c_str(), argv.data());
  return absl::NotFoundError(absl::StrCat(program, " cannot be started: ", std::strerror(errno),
                                          "; install it beside tessera (cmake --install), with "
                                          "python3"));
}

}  // namespace tessera
