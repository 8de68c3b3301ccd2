// A table whose rows are computed when they are first read: what a scene does not touch it does
// not pay for. A row is a pure function of its index, so it does not matter which thread computes
// it, nor that two may.
#pragma once

#include <array>
#include <atomic>
#include <memory>

namespace tessera {

template <typename Row, int kRows>
class LazyRows {
 public:
  LazyRows() = default;
  ~LazyRows() {
    for (auto& row : rows_) delete row.load(std::memory_order_relaxed);
  }
  LazyRows(const LazyRows&) = delete;
  LazyRows& operator=(const LazyRows&) = delete;

  // Row `index`; made by make(index), a Row, unless it exists. Threads: any number at once.
  template <typename Make>
  const Row& At(int index, const Make& make) const {
    const Row* row = rows_[index].load(std::memory_order_acquire);
    return row != nullptr ? *row : Publish(index, std::make_unique<const Row>(make(index)));
  }

 private:
  const Row& Publish(int index, std::unique_ptr<const Row> made) const {
    const Row* expected = nullptr;
    if (rows_[index].compare_exchange_strong(expected, made.get(), std::memory_order_acq_rel)) {
      return *made.release();
    }
    return *expected;
  }

  mutable std::array<std::atomic<const Row*>, kRows> rows_ = {};
};

}  // namespace tessera
