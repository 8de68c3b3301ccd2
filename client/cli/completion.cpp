#include "client/cli/completion.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"

namespace tessera {

std::string BashCompletion(const std::vector<CompletedCommand>& commands,
                           const std::vector<CompletedValues>& values) {
  std::string names;
  std::string flag_cases;
  for (const CompletedCommand& command : commands) {
    absl::StrAppend(&names, names.empty() ? "" : " ", command.name);
    absl::StrAppend(&flag_cases, "    ", command.name, ") flags='",
                    absl::StrJoin(command.flags, " "), "' ;;\n");
  }
  std::string value_cases;
  for (const CompletedValues& entry : values) {
    absl::StrAppend(&value_cases, "    ", entry.flag, ") COMPREPLY=($(compgen -W '",
                    absl::StrJoin(entry.values, " "), "' -- \"$current\")); return ;;\n");
  }
  return absl::StrCat(
      "# bash completion of tessera; printed by 'tessera completion'\n"
      "_tessera() {\n"
      "  local current=${COMP_WORDS[COMP_CWORD]} previous=${COMP_WORDS[COMP_CWORD-1]} flags=''\n"
      "  COMPREPLY=()\n"
      "  if ((COMP_CWORD == 1)); then\n"
      "    COMPREPLY=($(compgen -W '", names, " --help --version' -- \"$current\"))\n"
      "    return\n"
      "  fi\n"
      "  case $previous in\n", value_cases,
      "  esac\n"
      "  case ${COMP_WORDS[1]} in\n", flag_cases,
      "  esac\n"
      "  if [[ $current == -* ]]; then\n"
      "    COMPREPLY=($(compgen -W \"$flags\" -- \"$current\"))\n"
      "  else\n"
      "    compopt -o filenames 2>/dev/null\n"
      "    COMPREPLY=($(compgen -f -- \"$current\"))\n"
      "  fi\n"
      "}\n"
      "complete -F _tessera tessera\n");
}

}  // namespace tessera
