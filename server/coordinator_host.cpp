#include "server/coordinator_host.h"

#include <chrono>
#include <utility>

namespace tessera {

Instant Now() {
  using std::chrono::duration_cast;
  using std::chrono::milliseconds;
  return {duration_cast<milliseconds>(std::chrono::steady_clock::now().time_since_epoch()).count(),
          duration_cast<milliseconds>(std::chrono::system_clock::now().time_since_epoch()).count()};
}

CoordinatorHost::CoordinatorHost(CoordinatorConfig config, EffectSink& sink,
                                 std::function<Instant()> clock)
    : coordinator_(std::move(config)), sink_(sink), clock_(std::move(clock)) {}

CoordinatorHost::Answer CoordinatorHost::Post(Event event) {
  std::lock_guard lock(mu_);
  const auto begin = std::chrono::steady_clock::now();
  const StepResult result = coordinator_.Step(std::move(event), clock_());
  for (const Effect& effect : result.effects) sink_.Apply(effect);
  busy_ns_ += std::chrono::nanoseconds(std::chrono::steady_clock::now() - begin).count();
  return {result.status, result.job, result.is_new};
}

}  // namespace tessera
