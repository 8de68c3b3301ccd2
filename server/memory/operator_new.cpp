// tessera-server's operator new: large blocks are ours, others malloc's. Not where a sanitizer
// watches, which has an operator new of its own.
#include <cstdlib>
#include <new>

#include "server/memory/large_blocks.h"

#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)

void* operator new(size_t bytes) {
  if (void* const block = tessera::AllocateLargeBlock(bytes)) return block;
  for (;;) {
    if (void* const block = std::malloc(bytes > 0 ? bytes : 1)) return block;
    const std::new_handler handler = std::get_new_handler();
    if (handler == nullptr) throw std::bad_alloc();
    handler();
  }
}

void operator delete(void* block) noexcept {
  tessera::IsLargeBlock(block) ? tessera::FreeLargeBlock(block) : std::free(block);
}
void operator delete(void* block, size_t) noexcept { operator delete(block); }

#endif
