// Memory of planes: blocks of 4 KiB to 2 MiB, which come and go with every delta or stay in a
// film. Blocks of one size lie side by side in slabs, whichever thread asks for them, and what is
// given back is given out again: the kernel clears no page twice for tiles that pass through, nor
// for the film of a job that follows another one.
// tessera-server's operator new takes its blocks here (operator_new.cpp; docs/decisions/0018).
#pragma once

#include <cstddef>

namespace tessera {

// Null for sizes that are not kept here, and when the address space for slabs is used up or cannot
// be had: malloc's. Blocks are aligned to 256 bytes and not cleared.
// Threads: any; a lock is held for a few instructions.
void* AllocateLargeBlock(size_t bytes) noexcept;
// Whether it is a block of AllocateLargeBlock.
bool IsLargeBlock(const void* block) noexcept;
void FreeLargeBlock(void* block) noexcept;

// Gives a 512th of the slabs that have been empty since the last call back to the kernel, one at
// least. Called ten times a second, it halves what an idle server keeps in 35 s.
void TrimLargeBlocks() noexcept;

// Of all slabs that the kernel has given memory for, empty ones included.
size_t LargeBlockBytes() noexcept;

}  // namespace tessera
