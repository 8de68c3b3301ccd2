// The file of tokens that a server is started with, and authorization headers. Input: a header's
// length in one byte, the header, the file.
#include <cstdlib>

#include "server/security/access.h"
#include "tests/fuzz/fuzz_file.h"
#include "tests/fuzz/fuzz_target.h"

namespace tessera {
namespace {

struct Parsed {
  absl::StatusOr<Access> access;
  std::string_view header;
};

Parsed Parse(std::string_view input) {
  static const FuzzFile file(".tokens");
  const size_t length =
      input.empty() ? 0 : std::min<size_t>(static_cast<uint8_t>(input[0]), input.size() - 1);
  const std::string_view header = input.substr(std::min<size_t>(1, input.size()), length);
  file.Write(input.substr(std::min(input.size(), 1 + length)));
  return {Access::Open(file.path(), false), header};
}

std::string Seed(const std::string& header, const std::string& file) {
  return std::string(1, static_cast<char>(header.size())) + header + file;
}

}  // namespace

bool IsTaken(std::string_view input) {
  const Parsed parsed = Parse(input);
  return parsed.access.ok() && parsed.access->CheckHeader(parsed.header, Role::kView).ok();
}

void FuzzOne(std::string_view input) {
  const Parsed parsed = Parse(input);
  if (!parsed.access.ok()) {
    if (parsed.access.status().message().empty()) std::abort();
    return;
  }
  // A file that is taken never leaves the door open, and no role includes a stranger's.
  if (parsed.access->CheckHeader("", Role::kView).ok()) std::abort();
  const bool is_admin = parsed.access->CheckHeader(parsed.header, Role::kAdmin).ok();
  const bool is_worker = parsed.access->CheckHeader(parsed.header, Role::kWorker).ok();
  if (is_admin && (is_worker || !parsed.access->CheckHeader(parsed.header, Role::kView).ok())) {
    std::abort();
  }
}

std::vector<std::string> FuzzSeeds() {
  const std::string file =
      "# who may what\nview eve 0123456789abcdef0123\nadmin ada fedcba98765432100123\n"
      "\nworker farm 00112233445566778899\nsubmit sue 99887766554433221100\n";
  return {Seed("Bearer fedcba98765432100123", file),
          Seed("Basic ZXZlOjAxMjM0NTY3ODlhYmNkZWYwMTIz", file)};
}

}  // namespace tessera
