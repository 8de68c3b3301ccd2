// tessera-worker: renders with the path tracer.
#include "worker/session/path_tracer_renderer.h"
#include "worker/session/worker_program.h"

int main(int argc, char** argv) {
  return tessera::RunWorkerProgram(argc, argv, tessera::MakePathTracerFactory);
}
