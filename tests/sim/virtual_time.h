// The simulator's clock and the only order in which anything happens in it.
#pragma once

#include <cstdint>
#include <functional>
#include <queue>
#include <utility>
#include <vector>

namespace tessera {

inline constexpr int64_t kMs = 1000;  // in microseconds
inline constexpr int64_t kSecond = 1000 * kMs;
inline constexpr int64_t kNever = int64_t{1} << 60;

class VirtualTime {
 public:
  int64_t now_us() const { return now_us_; }

  // What is due at the same moment runs in the order in which it was asked for.
  void After(int64_t delay_us, std::function<void()> run) {
    items_.push({now_us_ + delay_us, next_++, std::move(run)});
  }
  // Runs what is due next, if that is before `end_us`.
  bool RunNext(int64_t end_us) {
    if (items_.empty() || items_.top().at_us >= end_us) return false;
    const std::function<void()> run = std::move(const_cast<Item&>(items_.top()).run);
    now_us_ = items_.top().at_us;
    items_.pop();
    run();
    return true;
  }

 private:
  struct Item {
    int64_t at_us;
    uint64_t order;
    std::function<void()> run;
    bool operator<(const Item& other) const {
      return std::pair(at_us, order) > std::pair(other.at_us, other.order);
    }
  };
  std::priority_queue<Item> items_;
  int64_t now_us_ = 0;
  uint64_t next_ = 0;
};

}  // namespace tessera
