// Two halves of any renderer's picture, and what may come with them, as the planes of a film.
#pragma once

#include "absl/status/statusor.h"
#include "client/cli/denoise_input.h"
#include "client/cli/flags.h"

namespace tessera {

// Reads what the flags name. The halves are pictures of one frame with independent noise and
// equally many samples. A feature comes from its own file, or from layers of the same name in both
// halves, or is done without; its noise comes from its variance, or from the difference of its
// halves, or counts as none. The variance of the mean comes from --variance, from layers
// variance.* of both halves, or from their difference. input.notes says what was found and how.
//
// Errors: INVALID_ARGUMENT, NOT_FOUND: a file that is missing, has other pixels or too few
// channels, or values that are no numbers, or negative variances; halves that are equal. Each names
// the file and the remedy. A variance that is no number is taken as unknown.
absl::StatusOr<DenoiseInput> ReadHalfImages(const HalvesFlags& flags);

}  // namespace tessera
