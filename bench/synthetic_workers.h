// Workers that render nothing: sessions that answer each lease at once with statistics rendered
// beforehand. They load a coordinator as hundreds of machines would.
#pragma once

#include <grpcpp/channel.h>

#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "core/base/sample_range.h"
#include "tessera/v1/worker.grpc.pb.h"
#include "worker/integrator/path_tracer.h"

namespace tessera {

// Encoded statistics of a tile of tile_size x tile_size pixels for every node of [0, spp) that a
// schedule of doubling passes asks for.
class DeltaStock {
 public:
  // Renders the tile at `window` of the scene.
  DeltaStock(const PathTracer& tracer, const PixelRect& window, int64_t spp, int64_t feature_end);

  // The delta that answers `lease`. Its window has the stock's size, its range is in the stock.
  v1::TileDelta Answer(const v1::Lease& lease) const;

 private:
  struct Entry {
    std::string payload;
    int64_t payload_bytes = 0;
    int64_t rays = 0;
    int64_t render_ns = 0;  // of one thread
  };
  int64_t feature_end_;
  std::map<int64_t, Entry> entries_;  // by the range's begin * 2^32 + size
};

struct LoadCounters {
  std::atomic<int64_t> welcomes = 0;
  std::atomic<int64_t> deltas = 0;
  std::atomic<int64_t> bytes = 0;
  std::atomic<int64_t> leases = 0;
};

// One worker's session. Ends when the stream does; Close ends it from this side.
class SyntheticWorker {
 public:
  // All references must outlive it.
  SyntheticWorker(const std::shared_ptr<grpc::Channel>& channel, int index,
                  const std::string& version, const DeltaStock& stock, LoadCounters* counters);
  ~SyntheticWorker();

  // Sends a heartbeat: one that has nothing to send is given nothing after the leases' time.
  void Beat();

 private:
  class Reactor;
  std::unique_ptr<v1::WorkerService::Stub> stub_;
  std::unique_ptr<Reactor> reactor_;
};

}  // namespace tessera
