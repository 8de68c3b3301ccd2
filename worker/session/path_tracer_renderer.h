// The session's renderer on top of the glTF loader and the path tracer.
#pragma once

#include <memory>

#include "worker/session/renderer.h"

namespace tessera {

std::unique_ptr<RendererFactory> MakePathTracerFactory();

}  // namespace tessera
