// tessera: the command line, linked with a coordinator and a worker.
#include "client/cli/command_line.h"
#include "embedded/embedded_farm.h"
#include "embedded/scene_description.h"

int main(int argc, char** argv) {
  return tessera::RunCommandLine(argc, argv,
                                 {.start_local_farm = tessera::StartEmbeddedFarm,
                                  .describe_scene = tessera::DescribeScene});
}
