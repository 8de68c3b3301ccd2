#include "core/film/tile_plane.h"

#include <algorithm>
#include <bit>
#include <cstring>
#include <map>
#include <mutex>
#include <utility>

namespace tessera {
namespace {

// As many zeros as a tile of 64 x 64 pixels has.
constexpr size_t kNumZeros = 4096;
template <typename Value>
alignas(64) constinit const Value zeros[kNumZeros] = {};

// The values that planes share, by bits and number of pixels, for as long as a plane has them.
template <typename Value>
class SharedValues {
 public:
  std::shared_ptr<const Value[]> Get(Value value, size_t num_pixels) {
    const Key key{std::bit_cast<uint32_t>(value), num_pixels};
    const std::lock_guard lock(mutex_);
    std::weak_ptr<const Value[]>& known = values_[key];
    if (std::shared_ptr<const Value[]> shared = known.lock()) return shared;
    auto values = std::make_unique_for_overwrite<Value[]>(num_pixels);
    std::fill_n(values.get(), num_pixels, value);
    const std::shared_ptr<const Value[]> shared(values.release(), [this, key](const Value* gone) {
      Forget(key);
      delete[] gone;
    });
    known = shared;
    return shared;
  }

 private:
  using Key = std::pair<uint32_t, size_t>;

  void Forget(const Key& key) {
    const std::lock_guard lock(mutex_);
    // Others may have come to share values of this key again.
    const auto known = values_.find(key);
    if (known != values_.end() && known->second.expired()) values_.erase(known);
  }

  std::mutex mutex_;
  std::map<Key, std::weak_ptr<const Value[]>> values_;
};

// Never destroyed: planes may outlive all that has a destructor.
template <typename Value>
SharedValues<Value>& Shared() {
  static auto* const shared = new SharedValues<Value>;
  return *shared;
}

template <typename Value>
bool IsZero(Value value) {
  return std::bit_cast<uint32_t>(value) == 0;
}

}  // namespace

template <typename Value>
TilePlane<Value>::TilePlane(size_t num_pixels) : num_pixels_(num_pixels) {
  SetConstant(0);
}

template <typename Value>
TilePlane<Value>& TilePlane<Value>::operator=(const TilePlane& other) {
  if (this == &other) return *this;
  if (other.own_ != nullptr) {
    if (num_pixels_ != other.num_pixels_) own_.reset();
    num_pixels_ = other.num_pixels_;
    std::ranges::copy(other.values(), Overwrite().begin());
  } else {
    num_pixels_ = other.num_pixels_;
    values_ = other.values_;
    own_.reset();
    shared_ = other.shared_;
  }
  return *this;
}

template <typename Value>
std::span<Value> TilePlane<Value>::Mutable() {
  if (own_ == nullptr) {
    // `other` keeps the values alive.
    const TilePlane other = *this;
    std::ranges::copy(other.values(), Overwrite().begin());
  }
  return {own_.get(), num_pixels_};
}

template <typename Value>
std::span<Value> TilePlane<Value>::Overwrite() {
  if (own_ == nullptr) {
    own_ = std::make_unique_for_overwrite<Value[]>(num_pixels_);
    values_ = own_.get();
    shared_.reset();
  }
  return {own_.get(), num_pixels_};
}

template <typename Value>
void TilePlane<Value>::SetConstant(Value value) {
  if (num_pixels_ > 0 && own_ == nullptr && values_ != nullptr &&
      std::bit_cast<uint32_t>(values_[0]) == std::bit_cast<uint32_t>(value)) {
    return;
  }
  if (IsZero(value) && num_pixels_ <= kNumZeros) {
    shared_.reset();
    values_ = zeros<Value>;
  } else {
    shared_ = Shared<Value>().Get(value, num_pixels_);
    values_ = shared_.get();
  }
  own_.reset();
}

template <typename Value>
void TilePlane<Value>::ShareIfConstant() {
  if (own_ == nullptr || num_pixels_ == 0) return;
  const auto first = std::bit_cast<uint32_t>(own_[0]);
  const bool is_constant = std::ranges::all_of(
      values(), [&](Value value) { return std::bit_cast<uint32_t>(value) == first; });
  if (is_constant) SetConstant(std::bit_cast<Value>(first));
}

template <typename Value>
bool TilePlane<Value>::HasBitsOf(const TilePlane& other) const {
  return num_pixels_ == other.num_pixels_ &&
         (values_ == other.values_ || num_pixels_ == 0 ||
          std::memcmp(values_, other.values_, num_pixels_ * sizeof(Value)) == 0);
}

template class TilePlane<float>;
template class TilePlane<uint32_t>;

}  // namespace tessera
