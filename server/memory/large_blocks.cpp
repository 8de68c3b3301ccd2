#include "server/memory/large_blocks.h"

#include <sys/mman.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cstdint>
#include <mutex>
#include <new>
#include <utility>

#include "core/base/check.h"

namespace tessera {
namespace {

constexpr size_t kBlockBytesMin = size_t{4} << 10;
constexpr size_t kSlabBytes = size_t{2} << 20;
constexpr size_t kSlabsMax = size_t{1} << 17;   // 256 GiB of addresses
constexpr size_t kHeaderBytes = 256;
// Sizes are rounded up to these.
constexpr size_t kGrainBytes = 1024;
constexpr size_t kNumSizes = kSlabBytes / kGrainBytes + 1;
constexpr size_t kTrimShare = 512;

// At the beginning of its 2 MiB; the blocks follow.
struct Slab {
  Slab* previous = nullptr;  // in the list of those of its size with room
  Slab* next = nullptr;      // there, or in the list of empty ones
  void* free_blocks = nullptr;  // given back; each begins with the address of the next
  size_t block_bytes = 0;
  uint32_t num_blocks = 0;
  uint32_t num_used = 0;
  uint32_t num_touched = 0;  // blocks after these have never been given out

  bool IsFull() const { return num_used == num_blocks; }
  void* Take() {
    ++num_used;
    if (free_blocks == nullptr) {
      return reinterpret_cast<char*>(this) + kHeaderBytes + block_bytes * num_touched++;
    }
    void* const block = free_blocks;
    free_blocks = *static_cast<void**>(block);
    return block;
  }
  void Return(void* block) {
    --num_used;
    *static_cast<void**>(block) = free_blocks;
    free_blocks = block;
  }
};
static_assert(sizeof(Slab) <= kHeaderBytes);

class Pool {
 public:
  void* Allocate(size_t bytes) {
    const size_t size = (bytes + kGrainBytes - 1) / kGrainBytes;
    const std::lock_guard lock(mutex_);
    Slab* slab = with_room_[size];
    if (slab == nullptr) {
      slab = NewSlab(size * kGrainBytes);
      if (slab == nullptr) return nullptr;
      Link(slab);
    }
    void* const block = slab->Take();
    if (slab->IsFull()) Unlink(slab);
    return block;
  }

  bool Holds(const void* block) const {
    const uintptr_t begin = begin_.load(std::memory_order_relaxed);
    return begin != 0 && reinterpret_cast<uintptr_t>(block) - begin < kSlabsMax * kSlabBytes;
  }

  void Free(void* block) {
    auto* const slab =
        reinterpret_cast<Slab*>(reinterpret_cast<uintptr_t>(block) / kSlabBytes * kSlabBytes);
    const std::lock_guard lock(mutex_);
    TESSERA_CHECK(slab->num_used > 0);
    if (slab->IsFull()) Link(slab);
    slab->Return(block);
    if (slab->num_used > 0) return;
    Unlink(slab);
    slab->next = empty_;
    empty_ = slab;
    ++num_empty_;
  }

  void Trim() {
    const std::lock_guard lock(mutex_);
    const size_t spare = std::exchange(spare_, num_empty_);
    for (size_t left = (spare + kTrimShare - 1) / kTrimShare; left > 0; --left) {
      Slab* const slab = TakeEmpty();
      madvise(slab, kSlabBytes, MADV_DONTNEED);
      released_[num_released_++] =
          static_cast<uint32_t>((reinterpret_cast<uintptr_t>(slab) - begin_) / kSlabBytes);
    }
    spare_ = num_empty_;
  }

  size_t bytes() {
    const std::lock_guard lock(mutex_);
    return (num_mapped_ - num_released_) * kSlabBytes;
  }

 private:
  Slab* TakeEmpty() {
    Slab* const slab = empty_;
    empty_ = slab->next;
    --num_empty_;
    spare_ = std::min(spare_, num_empty_);
    return slab;
  }

  // Null when there is no memory.
  Slab* NewSlab(size_t block_bytes) {
    void* const memory = empty_ != nullptr ? TakeEmpty() : MapSlab();
    if (memory == nullptr) return nullptr;
    Slab* const slab = new (memory) Slab;
    slab->block_bytes = block_bytes;
    slab->num_blocks = static_cast<uint32_t>((kSlabBytes - kHeaderBytes) / block_bytes);
    return slab;
  }

  void* MapSlab() {
    if (num_released_ > 0) return SlabAt(released_[--num_released_]);
    if (!has_addresses_) ReserveAddresses();
    if (begin_ == 0 || num_mapped_ == kSlabsMax) return nullptr;
    void* const slab = SlabAt(num_mapped_);
    if (mprotect(slab, kSlabBytes, PROT_READ | PROT_WRITE) != 0) return nullptr;
    ++num_mapped_;
    return slab;
  }
  void* SlabAt(size_t index) const { return reinterpret_cast<void*>(begin_ + index * kSlabBytes); }

  void ReserveAddresses() {
    has_addresses_ = true;
    constexpr size_t kBytes = (kSlabsMax + 1) * kSlabBytes;
    void* const mapped =
        mmap(nullptr, kBytes, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (mapped == MAP_FAILED) return;  // a limit of the process
    begin_ = (reinterpret_cast<uintptr_t>(mapped) + kSlabBytes - 1) / kSlabBytes * kSlabBytes;
  }

  void Link(Slab* slab) {
    Slab*& first = with_room_[slab->block_bytes / kGrainBytes];
    slab->previous = nullptr;
    slab->next = first;
    if (first != nullptr) first->previous = slab;
    first = slab;
  }
  void Unlink(Slab* slab) {
    if (slab->next != nullptr) slab->next->previous = slab->previous;
    if (slab->previous != nullptr) {
      slab->previous->next = slab->next;
    } else {
      with_room_[slab->block_bytes / kGrainBytes] = slab->next;
    }
  }

  std::atomic<uintptr_t> begin_ = 0;  // written once, with mutex_; 0 = no addresses yet
  std::mutex mutex_;                  // guards all below
  bool has_addresses_ = false;  // or they could not be had
  size_t num_mapped_ = 0;
  size_t num_released_ = 0;
  std::array<uint32_t, kSlabsMax> released_ = {};  // by index: their memory is the kernel's
  std::array<Slab*, kNumSizes> with_room_ = {};    // by size in grains: the first of a list
  Slab* empty_ = nullptr;
  size_t num_empty_ = 0;
  size_t spare_ = 0;  // the least num_empty_ since the last Trim
};

// Older than the first block and younger than the last: no code runs to make or to destroy it.
constinit Pool pool;

}  // namespace

void* AllocateLargeBlock(size_t bytes) noexcept {
  if (bytes < kBlockBytesMin || bytes > kSlabBytes - kHeaderBytes) return nullptr;
  return pool.Allocate(bytes);
}
bool IsLargeBlock(const void* block) noexcept { return pool.Holds(block); }
void FreeLargeBlock(void* block) noexcept { pool.Free(block); }
void TrimLargeBlocks() noexcept { pool.Trim(); }
size_t LargeBlockBytes() noexcept { return pool.bytes(); }

}  // namespace tessera
