// tessera: the command line, linked with a coordinator and a worker.
#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>

#include "client/cli/command_line.h"
#include "embedded/embedded_farm.h"
#include "embedded/scene_description.h"
#include "worker/integrator/arithmetic.h"
#include "worker/integrator/path_tracer.h"

int main(int argc, char** argv) {
  // stdout belongs to results; of the farm inside only what went wrong is worth a line.
  spdlog::set_default_logger(spdlog::stderr_color_mt("tessera"));
  spdlog::set_level(spdlog::level::warn);
  return tessera::RunCommandLine(argc, argv,
                                 {.start_local_farm = tessera::StartEmbeddedFarm,
                                  .describe_scene = tessera::DescribeScene,
                                  .isa_classes = tessera::SupportedIsaClasses(),
                                  .arithmetic_of = tessera::ArithmeticOf});
}
