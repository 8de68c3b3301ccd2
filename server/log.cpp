#include "server/log.h"

#include <spdlog/sinks/null_sink.h>
#include <spdlog/sinks/stdout_color_sinks.h>

namespace tessera {

spdlog::logger& ServerLog() {
  static auto* const logger =
      new spdlog::logger("tessera-server", std::make_shared<spdlog::sinks::null_sink_mt>());
  return *logger;
}

void LogToStderr(bool verbose) {
  spdlog::logger& logger = ServerLog();
  logger.sinks() = {std::make_shared<spdlog::sinks::stderr_color_sink_mt>()};
  logger.set_pattern("%Y-%m-%dT%H:%M:%S.%eZ %l %v", spdlog::pattern_time_type::utc);
  logger.set_level(verbose ? spdlog::level::debug : spdlog::level::info);
}

}  // namespace tessera
