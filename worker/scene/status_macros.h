// Early returns for absl::Status and absl::StatusOr.
#pragma once

#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

#define TESSERA_RETURN_IF_ERROR(expression)                             \
  do {                                                                  \
    if (absl::Status early_status = (expression); !early_status.ok()) { \
      return early_status;                                              \
    }                                                                   \
  } while (false)

#define TESSERA_STATUS_JOIN_INNER(a, b) a##b
#define TESSERA_STATUS_JOIN(a, b) TESSERA_STATUS_JOIN_INNER(a, b)
#define TESSERA_ASSIGN_OR_RETURN_INNER(result, target, expression) \
  auto result = (expression);                                      \
  if (!result.ok()) return std::move(result).status();             \
  target = *std::move(result)

// TESSERA_ASSIGN_OR_RETURN(auto x, F()): x is F()'s value, or the error is returned.
#define TESSERA_ASSIGN_OR_RETURN(target, expression) \
  TESSERA_ASSIGN_OR_RETURN_INNER(TESSERA_STATUS_JOIN(result_, __LINE__), target, expression)
