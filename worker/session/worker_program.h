// tessera-worker's main function, with a renderer of the caller's choice.
#pragma once

#include <functional>
#include <memory>

#include "worker/session/renderer.h"

namespace tessera {

// Renders for a coordinator until it is told to stop. Exit codes: 0 drained, 2 bad input or
// refused, 3 server unavailable, 4 interrupted twice, 1 a bug.
int RunWorkerProgram(int argc, char** argv,
                     const std::function<std::unique_ptr<RendererFactory>()>& make_factory);

}  // namespace tessera
