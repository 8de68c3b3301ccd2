#include "worker/scene/gltf_object.h"

#include <cmath>
#include <limits>
#include <utility>

#include "absl/strings/str_cat.h"

namespace tessera {
namespace {

absl::string_view Absl(std::string_view text) { return {text.data(), text.size()}; }

// Whether `value` is a whole number in [min, max]; exporters also write 3 as 3.0.
bool ReadInteger(const nlohmann::json& value, int64_t min, int64_t max, int64_t* out) {
  if (value.is_number_unsigned()) {
    const uint64_t number = value.get<uint64_t>();
    if (number > static_cast<uint64_t>(std::numeric_limits<int64_t>::max())) return false;
    *out = static_cast<int64_t>(number);
  } else if (value.is_number_integer()) {
    *out = value.get<int64_t>();
  } else if (value.is_number_float()) {
    const double number = value.get<double>();
    constexpr double kExact = 9007199254740992.0;  // 2^53
    if (!(std::abs(number) <= kExact) || number != std::floor(number)) return false;
    *out = static_cast<int64_t>(number);
  } else {
    return false;
  }
  return *out >= min && *out <= max;
}

bool ReadFinite(const nlohmann::json& value, double* out) {
  if (!value.is_number()) return false;
  *out = value.get<double>();
  return std::isfinite(*out);
}

}  // namespace

GltfObject::GltfObject(const nlohmann::json* value, std::string path, absl::Status* status)
    : value_(value), path_(std::move(path)), status_(status) {
  if (value_ != nullptr && !value_->is_object()) {
    Fail("", "must be a JSON object");
    value_ = nullptr;
  }
}

const nlohmann::json* GltfObject::Find(std::string_view field) const {
  if (value_ == nullptr) return nullptr;
  const auto found = value_->find(field);
  return found == value_->end() ? nullptr : &*found;
}

void GltfObject::Fail(std::string_view field, std::string_view problem) const {
  if (!status_->ok()) return;
  const char* dot = path_.empty() || field.empty() ? "" : ".";
  *status_ = absl::InvalidArgumentError(absl::StrCat(path_, dot, Absl(field), ": ", Absl(problem)));
}

double GltfObject::Number(std::string_view field, double fallback) const {
  double number = fallback;
  if (const nlohmann::json* value = Find(field); value && !ReadFinite(*value, &number)) {
    Fail(field, "must be a finite number");
    return fallback;
  }
  return number;
}

bool GltfObject::ReadNumbers(std::string_view field, size_t count, double* out) const {
  const nlohmann::json* value = Find(field);
  if (value == nullptr) return false;
  bool valid = value->is_array() && value->size() == count;
  for (size_t i = 0; valid && i < count; ++i) valid = ReadFinite((*value)[i], &out[i]);
  if (!valid) Fail(field, absl::StrCat("must be ", count, " finite numbers"));
  return valid;
}

std::vector<double> GltfObject::NumberList(std::string_view field) const {
  const nlohmann::json* value = Find(field);
  if (value == nullptr) return {};
  bool valid = value->is_array();
  std::vector<double> numbers(valid ? value->size() : 0);
  for (size_t i = 0; valid && i < numbers.size(); ++i) valid = ReadFinite((*value)[i], &numbers[i]);
  if (valid) return numbers;
  Fail(field, "must be an array of finite numbers");
  return {};
}

bool GltfObject::Flag(std::string_view field, bool fallback) const {
  const nlohmann::json* value = Find(field);
  if (value == nullptr) return fallback;
  if (value->is_boolean()) return value->get<bool>();
  Fail(field, "must be true or false");
  return fallback;
}

std::string GltfObject::Text(std::string_view field, std::string_view fallback) const {
  const nlohmann::json* value = Find(field);
  if (value == nullptr) return std::string(fallback);
  if (value->is_string()) return value->get<std::string>();
  Fail(field, "must be a text");
  return std::string(fallback);
}

int64_t GltfObject::Integer(std::string_view field, int64_t fallback, int64_t min,
                            int64_t max) const {
  const nlohmann::json* value = Find(field);
  if (value == nullptr) return fallback;
  int64_t number = 0;
  if (ReadInteger(*value, min, max, &number)) return number;
  Fail(field, absl::StrCat("must be a whole number in [", min, ", ", max, "]"));
  return fallback;
}

int GltfObject::Index(std::string_view field, int table_size) const {
  const nlohmann::json* value = Find(field);
  if (value == nullptr) return -1;
  int64_t number = 0;
  if (ReadInteger(*value, 0, int64_t{table_size} - 1, &number)) return static_cast<int>(number);
  Fail(field, absl::StrCat("index out of range: only ", table_size, " entries exist"));
  return -1;
}

std::vector<int> GltfObject::IndexList(std::string_view field, int table_size) const {
  const nlohmann::json* value = Find(field);
  if (value == nullptr) return {};
  bool valid = value->is_array();
  std::vector<int> indices;
  for (size_t i = 0; valid && i < value->size(); ++i) {
    int64_t number = 0;
    valid = ReadInteger((*value)[i], 0, int64_t{table_size} - 1, &number);
    indices.push_back(static_cast<int>(number));
  }
  if (valid) return indices;
  Fail(field, absl::StrCat("must be an array of indices below ", table_size));
  return {};
}

GltfObject GltfObject::Object(std::string_view field) const {
  return GltfObject(Find(field), absl::StrCat(path_, path_.empty() ? "" : ".", Absl(field)),
                    status_);
}

GltfObject GltfObject::Extension(std::string_view name) const {
  return Object("extensions").Object(name);
}

std::vector<GltfObject> GltfObject::Objects(std::string_view field) const {
  const nlohmann::json* value = Find(field);
  if (value == nullptr) return {};
  if (!value->is_array()) {
    Fail(field, "must be an array of objects");
    return {};
  }
  std::vector<GltfObject> objects;
  objects.reserve(value->size());
  const char* dot = path_.empty() ? "" : ".";
  for (size_t i = 0; i < value->size(); ++i) {
    objects.emplace_back(&(*value)[i], absl::StrCat(path_, dot, Absl(field), "[", i, "]"), status_);
  }
  return objects;
}

GltfObject GltfObject::Element(std::string_view field, int index) const {
  const char* dot = path_.empty() ? "" : ".";
  return GltfObject(&(*Find(field))[static_cast<size_t>(index)],
                    absl::StrCat(path_, dot, Absl(field), "[", index, "]"), status_);
}

}  // namespace tessera
