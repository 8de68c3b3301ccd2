// A server that takes deltas and drops them: what gRPC alone reaches on this machine.
#pragma once

#include <cstdint>
#include <string>

namespace tessera {

// Serves WorkerService.Work on loopback in rounds, one for each ListWorkers: hands `num_leases`
// leases of `tile_size` x `tile_size` pixels, `ahead` to each session at once, in the order of
// tiles of a frame of `num_tiles`, passes that double up to `spp` >= 2, again and again; reads the
// deltas and counts them. Writes its port to `port_file`. Returns when `num_rounds` rounds have
// come.
void RunBareStreamServer(const std::string& port_file, int num_rounds, int64_t num_leases,
                         int64_t num_tiles, int64_t spp, int tile_size, int ahead);

}  // namespace tessera
