#include "server/security/access.h"

#include <sys/stat.h>

#include <fstream>
#include <sstream>

#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"

namespace tessera {
namespace {

constexpr size_t kTokenCharactersMin = 16;  // 64 bits in hexadecimal: not to be guessed
constexpr size_t kNameCharactersMax = 64;
constexpr int kTokensMax = 10000;

constexpr std::pair<const char*, Role> kRoles[] = {{"view", Role::kView},
                                                   {"submit", Role::kSubmit},
                                                   {"admin", Role::kAdmin},
                                                   {"worker", Role::kWorker}};

const char* NameOf(Role role) {
  for (const auto& [name, value] : kRoles) {
    if (value == role) return name;
  }
  return "";
}

bool Includes(Role has, Role needed) {
  if (has == Role::kWorker || needed == Role::kWorker) return has == needed;
  return has >= needed;
}

absl::StatusOr<Caller> Permit(const Caller& caller, Role needed) {
  if (Includes(caller.role, needed)) return caller;
  return absl::PermissionDeniedError(
      absl::StrCat("the token of '", caller.name, "' has the role ", NameOf(caller.role),
                   ", this needs ", NameOf(needed), ": ask who runs the server for such a token"));
}

// The token in an authorization header; empty if there is none.
std::string TokenIn(std::string_view authorization) {
  absl::string_view rest(authorization.data(), authorization.size());
  if (absl::ConsumePrefix(&rest, "Bearer ")) return std::string(rest);
  std::string user_and_password;
  if (absl::ConsumePrefix(&rest, "Basic ") && absl::Base64Unescape(rest, &user_and_password)) {
    const size_t colon = user_and_password.find(':');
    if (colon != std::string::npos) return user_and_password.substr(colon + 1);
  }
  return "";
}

}  // namespace

absl::StatusOr<Access> Access::Open(const std::string& token_file, bool require_certificates) {
  Access access;
  access.require_certificates_ = require_certificates;
  if (token_file.empty()) return access;
  const auto bad = [&token_file](const std::string& why) {
    return absl::InvalidArgumentError(absl::StrCat("--token-file ", token_file, why));
  };
  struct stat info {};
  if (stat(token_file.c_str(), &info) != 0 || !S_ISREG(info.st_mode)) {
    return bad(" is no file: check the path");
  }
  if ((info.st_mode & (S_IRWXG | S_IRWXO)) != 0) {
    return bad(" can be read by others: chmod 600 it");
  }
  std::ifstream file(token_file);
  if (!file) return bad(" cannot be read: it must belong to who runs the server");
  std::string line;
  for (int number = 1; std::getline(file, line); ++number) {
    std::istringstream words(line);
    std::string role, name, token, rest;
    if (!(words >> role) || role.front() == '#') continue;
    const std::string where = absl::StrCat(" line ", number, ": ");
    words >> name >> token;
    if (token.empty() || words >> rest) return bad(where + "give ROLE NAME TOKEN");
    Caller caller{.name = name};
    bool known = false;
    for (const auto& [text, value] : kRoles) {
      if (role != text) continue;
      caller.role = value;
      known = true;
    }
    if (!known) return bad(absl::StrCat(where, "the role is view, submit, admin or worker"));
    if (token.size() < kTokenCharactersMin) {
      return bad(absl::StrCat(where, "the token has fewer than ", kTokenCharactersMin,
                              " characters: make one with openssl rand -hex 32"));
    }
    if (name.size() > kNameCharactersMax) {
      return bad(absl::StrCat(where, "the name has more than ", kNameCharactersMax, " characters"));
    }
    if (!access.callers_.emplace(Sha256Of(token), caller).second) {
      return bad(where + "the token is there already");
    }
    if (std::ssize(access.callers_) > kTokensMax) return bad(" holds too many tokens");
  }
  if (access.callers_.empty()) {
    return bad(" names no token: give lines of ROLE NAME TOKEN, or drop the flag");
  }
  return access;
}

absl::StatusOr<Caller> Access::CheckHeader(std::string_view authorization, Role needed) const {
  if (open()) return Caller{};
  const std::string token = TokenIn(authorization);
  if (token.empty()) {
    return absl::UnauthenticatedError(
        has_tokens() ? "this server asks for a token: give --token-file with one"
                     : "this server asks for a certificate: give --cert and --key");
  }
  // Looked up by digest: how long it takes says nothing about tokens.
  const auto caller = callers_.find(Sha256Of(token));
  if (caller == callers_.end()) {
    return absl::UnauthenticatedError(
        "the token is not one of this server's: ask who runs it for a new one");
  }
  return Permit(caller->second, needed);
}

absl::StatusOr<Caller> Access::Check(const grpc::ServerContextBase& context, Role needed) const {
  if (open()) return Caller{};
  if (require_certificates_ && context.auth_context()->IsPeerAuthenticated() &&
      (needed == Role::kWorker || !has_tokens())) {
    return Caller{.name = "", .role = needed == Role::kWorker ? Role::kWorker : Role::kAdmin};
  }
  const auto header = context.client_metadata().find("authorization");
  const std::string_view value =
      header == context.client_metadata().end()
          ? std::string_view()
          : std::string_view(header->second.data(), header->second.size());
  return CheckHeader(value, needed);
}

}  // namespace tessera
