// The bash completion of the command line, made from the commands and flags that it has.
#pragma once

#include <string>
#include <vector>

namespace tessera {

struct CompletedCommand {
  std::string name;
  std::vector<std::string> flags;  // "--spp"
};

// Flags whose value is one of a few words.
struct CompletedValues {
  std::string flag;
  std::vector<std::string> values;
};

// A script for `source` or a bash-completion folder.
std::string BashCompletion(const std::vector<CompletedCommand>& commands,
                           const std::vector<CompletedValues>& values);

}  // namespace tessera
