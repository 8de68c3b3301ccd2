// SHA-256 (OpenSSL) of bytes in memory and of files.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"

namespace tessera {

using Sha256Digest = std::array<uint8_t, 32>;

class Sha256 {
 public:
  Sha256();
  ~Sha256();
  Sha256(const Sha256&) = delete;
  Sha256& operator=(const Sha256&) = delete;

  void Update(std::span<const std::byte> bytes);
  void Update(std::string_view bytes);
  Sha256Digest Finish();

 private:
  struct Context;
  std::unique_ptr<Context> context_;
};

Sha256Digest Sha256Of(std::string_view bytes);
// Errors: NOT_FOUND or PERMISSION_DENIED naming the file.
absl::StatusOr<Sha256Digest> Sha256OfFile(const std::string& path);

std::string ToHex(const Sha256Digest& digest);      // 64 lower-case digits
std::string ToBytes(const Sha256Digest& digest);    // 32 raw bytes, as in the protos
// Errors: INVALID_ARGUMENT unless `bytes` is 32 long.
absl::StatusOr<Sha256Digest> Sha256FromBytes(std::string_view bytes);

}  // namespace tessera
