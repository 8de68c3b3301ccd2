// The server in Prometheus' text format.
#pragma once

#include <string>

#include "server/coordinator_host.h"
#include "server/picture/filter_desk.h"

namespace tessera {

inline constexpr char kMetricsContentType[] = "text/plain; version=0.0.4; charset=utf-8";

// Jobs by state, workers, leases, merged samples, rays and bytes, time to the first picture, and
// this process's memory and processor time. Names end in their unit; counters in _total count since
// the server started. Threads: any.
std::string MetricsText(const CoordinatorHost& host, const FilterDesk::Totals& filtering);

}  // namespace tessera
