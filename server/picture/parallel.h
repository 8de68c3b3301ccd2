// A loop over a few threads of its own, which knows what it cost.
#pragma once

#include <cstddef>
#include <functional>

namespace tessera {

// Calls body(0) ... body(count - 1), each once, on the calling thread and num_threads - 1 others,
// in no fixed order. Returns the seconds of CPU that the calls took, all threads together: time in
// which other programs had the cores does not count.
double ParallelFor(size_t count, int num_threads, const std::function<void(size_t)>& body);

}  // namespace tessera
