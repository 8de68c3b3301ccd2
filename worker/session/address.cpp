#include "worker/session/address.h"

#include <charconv>
#include <string>

#include "absl/strings/str_cat.h"

namespace tessera {

absl::Status CheckAddress(std::string_view address, bool insecure) {
  const std::string shown(address);
  const size_t colon = address.rfind(':');
  std::string_view host = address.substr(0, colon == std::string_view::npos ? 0 : colon);
  int port = 0;
  if (colon != std::string_view::npos) {
    const std::string_view digits = address.substr(colon + 1);
    const auto [end, code] = std::from_chars(digits.data(), digits.data() + digits.size(), port);
    if (code != std::errc() || end != digits.data() + digits.size()) port = 0;
  }
  if (host.size() > 2 && host.front() == '[' && host.back() == ']') {
    host = host.substr(1, host.size() - 2);
  } else if (host.find(':') != std::string_view::npos) {
    host = {};
  }
  if (host.empty() || port < 1 || port > 65535) {
    return absl::InvalidArgumentError(
        absl::StrCat("'", shown, "' is not HOST:PORT, for example 127.0.0.1:4242"));
  }
  const bool loopback = host == "localhost" || host == "::1" ||
                        (host.starts_with("127.") &&
                         host.find_first_not_of("0123456789.") == std::string_view::npos);
  if (!loopback && !insecure) {
    return absl::InvalidArgumentError(
        absl::StrCat("plain text to another machine (", shown,
                     "): say --insecure if you trust the network between"));
  }
  return absl::OkStatus();
}

}  // namespace tessera
