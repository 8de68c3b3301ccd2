// What a worker's process has in hand, in memory that it shares with its supervising parent and
// that outlives it: written before each unit and each building of a scene, so that the parent can
// say what was being done when the process was ended.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <string>

#include "tessera/v1/worker.pb.h"

namespace tessera {

// Threads: each slot by one thread at a time; the building by one.
class UnitJournal {
 public:
  static constexpr int kSlotsMax = 1024;  // of further threads nothing is known

  struct Unmap {
    void operator()(UnitJournal* journal) const;
  };
  using Shared = std::unique_ptr<UnitJournal, Unmap>;
  // Shared with the processes that are started later. Null when there is no memory for it.
  static Shared Create();
  // The one that another process has made, of which this one has the descriptor. Null when it is
  // none.
  static Shared Open(int descriptor);

  int descriptor() const { return descriptor_; }  // the same in all processes that inherit it

  void Clear();
  void BeginUnit(int slot, const v1::Lease& lease);
  void EndUnit(int slot);
  void BeginBuild(const std::string& job);
  void EndBuild();

  // What is in hand; read it once the process has ended.
  v1::CrashReport Report() const;

 private:
  // Longer names are not the server's: such a job is not written down.
  static constexpr size_t kNameBytes = 40;
  struct Name {
    std::atomic<bool> used = false;
    std::array<char, kNameBytes> text = {};
    bool Set(const std::string& name);
  };
  struct Unit {
    Name job;
    int64_t tile_index = 0;
    int64_t sample_begin = 0;
    int64_t sample_end = 0;
  };
  UnitJournal() = default;

  int descriptor_ = -1;
  std::array<Unit, kSlotsMax> units_;
  Name build_;
};

}  // namespace tessera
