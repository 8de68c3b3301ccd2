// The server's log: silent inside other programs until main gives it a sink.
#pragma once

#include <spdlog/logger.h>

namespace tessera {

// Lines are "key=value ... words". Threads: any.
spdlog::logger& ServerLog();

// Logs to stderr from here on. Call it before any thread starts.
void LogToStderr(bool verbose);

}  // namespace tessera
