#include "proto/channel/server_address.h"

#include <algorithm>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"

namespace tessera {
namespace {

std::string HostOf(const std::string& address) { return address.substr(0, address.rfind(':')); }

}  // namespace

absl::Status CheckServerAddress(const std::string& address) {
  const auto bad = [&address](const std::string& why) {
    return absl::InvalidArgumentError(absl::StrCat(
        "--server ", address, ": ", why, ": give HOST:PORT such as 127.0.0.1:4242 or [::1]:4242"));
  };
  if (absl::StrContains(address, "://")) return bad("is a URL");
  if (address.empty() || address.back() == ']' || !absl::StrContains(address, ':')) {
    return bad("names no port");
  }
  const std::string host = HostOf(address);
  const bool bracketed = host.size() > 2 && host.front() == '[' && host.back() == ']';
  if (!bracketed && absl::StrContains(host, ':')) return bad("an IPv6 address needs brackets");
  int port = 0;
  if (!absl::SimpleAtoi(address.substr(host.size() + 1), &port) || port < 1 || port > 65535) {
    return bad("its port is no number from 1 to 65535");
  }
  const auto is_name = [](char c) { return absl::ascii_isgraph(static_cast<unsigned char>(c)); };
  if (host.empty() || !std::ranges::all_of(host, is_name) || absl::StrContains(host, '/') ||
      (!bracketed && host.find_first_of("[]") != std::string::npos)) {
    return bad("names no host");
  }
  return absl::OkStatus();
}

bool IsLoopback(const std::string& address) {
  const std::string host = HostOf(address);
  // A name may begin with 127. too: only numbers are this machine's.
  return host == "localhost" || host == "[::1]" || absl::StartsWith(address, "unix:") ||
         (absl::StartsWith(host, "127.") &&
          host.find_first_not_of("0123456789.") == std::string::npos);
}

}  // namespace tessera
