// A JSON object of a glTF file, read field by field with its place in the file at hand. A wrong
// field gives its default and records an error; the first error sticks, so that a reader checks
// once after reading all fields.
#pragma once

#include <array>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"

namespace tessera {

class GltfObject {
 public:
  // `value` and `status` outlive the object; a null value reads as an empty object.
  GltfObject(const nlohmann::json* value, std::string path, absl::Status* status);

  const std::string& path() const { return path_; }  // such as "materials[3]"
  const absl::Status& status() const { return *status_; }
  bool exists() const { return value_ != nullptr; }
  bool Has(std::string_view field) const { return Find(field) != nullptr; }

  // Finite numbers.
  double Number(std::string_view field, double fallback) const;
  template <size_t N>
  std::array<double, N> Numbers(std::string_view field,
                                const std::array<double, N>& fallback) const;
  std::vector<double> NumberList(std::string_view field) const;
  bool Flag(std::string_view field, bool fallback) const;
  std::string Text(std::string_view field, std::string_view fallback = "") const;
  // A whole number in [min, max].
  int64_t Integer(std::string_view field, int64_t fallback, int64_t min, int64_t max) const;
  // An index into a table of `table_size` entries; -1 when absent.
  int Index(std::string_view field, int table_size) const;
  std::vector<int> IndexList(std::string_view field, int table_size) const;

  // Absent: an object that does not exist.
  GltfObject Object(std::string_view field) const;
  GltfObject Extension(std::string_view name) const;
  // The objects of an array field; absent: none.
  std::vector<GltfObject> Objects(std::string_view field) const;
  // Entry `index` of an array field, which exists.
  GltfObject Element(std::string_view field, int index) const;

  // Records "<path>.<field>: <problem>" unless an earlier error stands.
  void Fail(std::string_view field, std::string_view problem) const;

 private:
  const nlohmann::json* Find(std::string_view field) const;
  bool ReadNumbers(std::string_view field, size_t count, double* out) const;

  const nlohmann::json* value_;
  std::string path_;
  absl::Status* status_;
};

template <size_t N>
std::array<double, N> GltfObject::Numbers(std::string_view field,
                                          const std::array<double, N>& fallback) const {
  std::array<double, N> out = fallback;
  return ReadNumbers(field, N, out.data()) ? out : fallback;
}

}  // namespace tessera
