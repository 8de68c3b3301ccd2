#include "worker/session/unit_journal.h"

#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstring>
#include <new>

namespace tessera {
namespace {

// Null when there is no memory.
void* Map(int descriptor) {
  void* const memory =
      mmap(nullptr, sizeof(UnitJournal), PROT_READ | PROT_WRITE, MAP_SHARED, descriptor, 0);
  return memory == MAP_FAILED ? nullptr : memory;
}

}  // namespace

UnitJournal::Shared UnitJournal::Create() {
  const int descriptor = memfd_create("units", 0);
  if (descriptor < 0) return nullptr;
  void* const memory = ftruncate(descriptor, sizeof(UnitJournal)) == 0 ? Map(descriptor) : nullptr;
  if (memory == nullptr) {
    close(descriptor);
    return nullptr;
  }
  Shared journal(new (memory) UnitJournal());
  journal->descriptor_ = descriptor;
  return journal;
}

UnitJournal::Shared UnitJournal::Open(int descriptor) {
  struct stat status;
  if (fstat(descriptor, &status) != 0 || status.st_size != sizeof(UnitJournal)) return nullptr;
  return Shared(static_cast<UnitJournal*>(Map(descriptor)));
}

void UnitJournal::Unmap::operator()(UnitJournal* journal) const {
  close(journal->descriptor_);
  munmap(journal, sizeof(UnitJournal));
}

bool UnitJournal::Name::Set(const std::string& name) {
  if (name.size() >= kNameBytes) return false;
  std::memcpy(text.data(), name.c_str(), name.size() + 1);
  return true;
}

void UnitJournal::Clear() {
  for (int slot = 0; slot < kSlotsMax; ++slot) EndUnit(slot);
  EndBuild();
}

void UnitJournal::BeginUnit(int slot, const v1::Lease& lease) {
  if (slot >= kSlotsMax) return;
  Unit& unit = units_[static_cast<size_t>(slot)];
  if (!unit.job.Set(lease.job())) return;
  unit.tile_index = lease.tile_index();
  unit.sample_begin = lease.sample_begin();
  unit.sample_end = lease.sample_end();
  // Last: a process that ends amid this has not begun the unit.
  unit.job.used.store(true, std::memory_order_release);
}

void UnitJournal::EndUnit(int slot) {
  if (slot >= kSlotsMax) return;
  units_[static_cast<size_t>(slot)].job.used.store(false, std::memory_order_release);
}

void UnitJournal::BeginBuild(const std::string& job) {
  if (build_.Set(job)) build_.used.store(true, std::memory_order_release);
}

void UnitJournal::EndBuild() { build_.used.store(false, std::memory_order_release); }

v1::CrashReport UnitJournal::Report() const {
  v1::CrashReport report;
  for (const Unit& unit : units_) {
    if (!unit.job.used.load(std::memory_order_acquire)) continue;
    v1::CrashReport::Unit& named = *report.add_units();
    named.set_job(unit.job.text.data());
    named.set_tile_index(unit.tile_index);
    named.set_sample_begin(unit.sample_begin);
    named.set_sample_end(unit.sample_end);
  }
  if (build_.used.load(std::memory_order_acquire)) report.set_building_job(build_.text.data());
  return report;
}

}  // namespace tessera
