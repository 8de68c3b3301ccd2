// One plane of a tile: a value for each pixel. A plane of one value, such as the depth of the sky
// or the material of a wall, takes no memory of its own: all tiles share one copy of it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>

namespace tessera {

// Value: float or uint32_t.
// Threads: as for a vector; planes that share values may be used side by side.
template <typename Value>
class TilePlane {
 public:
  TilePlane() = default;
  // All zero.
  explicit TilePlane(size_t num_pixels);
  TilePlane(const TilePlane& other) { *this = other; }
  TilePlane& operator=(const TilePlane& other);
  TilePlane(TilePlane&&) = default;
  TilePlane& operator=(TilePlane&&) = default;
  ~TilePlane() = default;

  size_t size() const { return num_pixels_; }
  std::span<const Value> values() const { return {values_, num_pixels_}; }
  // The value of all pixels where it is known to be one; a plane with memory of its own may happen
  // to have one, too.
  std::optional<Value> constant() const {
    if (own_ != nullptr || num_pixels_ == 0) return std::nullopt;
    return values_[0];
  }
  // Of its own memory.
  size_t num_bytes() const { return own_ == nullptr ? 0 : num_pixels_ * sizeof(Value); }

  // The values, to be changed.
  std::span<Value> Mutable();
  // The same for one who writes all of them: their values are unspecified.
  std::span<Value> Overwrite();
  void SetConstant(Value value);
  // Gives its memory back if all values have the same bits.
  void ShareIfConstant();

  // Of the bits.
  friend bool operator==(const TilePlane& a, const TilePlane& b) { return a.HasBitsOf(b); }

 private:
  bool HasBitsOf(const TilePlane& other) const;

  size_t num_pixels_ = 0;
  const Value* values_ = nullptr;  // in one of these, or the zeros that are always there
  std::unique_ptr<Value[]> own_;
  std::shared_ptr<const Value[]> shared_;
};

}  // namespace tessera
