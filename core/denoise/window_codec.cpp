#include "core/denoise/window_codec.h"

#include <xxhash.h>
#include <zstd.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <memory>
#include <span>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/base/check.h"
#include "core/film/plane_coding.h"

namespace tessera {
namespace {

static_assert(std::endian::native == std::endian::little);

constexpr int kCompressionLevel = 1;
constexpr size_t kHeaderBytes = 6;
constexpr size_t kPlaneBytesMax = 4;  // of a pixel

using Words = std::vector<uint32_t>;

absl::Status Malformed(std::string_view what) {
  return absl::InvalidArgumentError(
      absl::StrCat("filter planes: ", absl::string_view(what.data(), what.size()),
                   "; they were damaged on their way or come from another version"));
}

// A plane of either kind, and the one that it resembles (an index into the list; -1: none).
struct PlaneView {
  void* data;
  bool is_float;
  int like = -1;
};

void AddVector(Planes3& planes, int like, std::vector<PlaneView>* views) {
  for (size_t c = 0; c < 3; ++c) {
    views->push_back({planes[c].data(), true, like < 0 ? -1 : like + static_cast<int>(c)});
  }
}

std::vector<PlaneView> ViewsOf(FramePlanes& planes) {
  std::vector<PlaneView> views;
  AddVector(planes.color, -1, &views);
  AddVector(planes.color_half[0], 0, &views);
  AddVector(planes.color_half[1], 3, &views);
  AddVector(planes.sample_variance_of_mean, -1, &views);
  AddVector(planes.variance, -1, &views);
  AddVector(planes.albedo, -1, &views);
  AddVector(planes.albedo_variance, -1, &views);
  AddVector(planes.normal, -1, &views);
  AddVector(planes.normal_variance, -1, &views);
  for (Plane* plane : {&planes.depth, &planes.depth_variance, &planes.coverage}) {
    views.push_back({plane->data(), true});
  }
  views.push_back({planes.material_id.data(), false});
  views.push_back({planes.samples.data(), false});
  return views;
}

std::vector<PlaneView> ViewsOf(FilteredPlanes& planes) {
  std::vector<PlaneView> views;
  AddVector(planes.color, -1, &views);
  AddVector(planes.error, -1, &views);
  views.push_back({planes.relative_error.data(), true});
  views.push_back({planes.relative_noise.data(), true});
  return views;
}

// The rectangle's words of a plane over `bounds`.
Words Cut(const PlaneView& view, const PixelRect& bounds, const PixelRect& rect) {
  Words words(static_cast<size_t>(rect.area()));
  const auto width = static_cast<size_t>(rect.width());
  for (int y = rect.y_begin; y < rect.y_end; ++y) {
    std::memcpy(words.data() + rect.IndexOf(rect.x_begin, y),
                static_cast<const uint32_t*>(view.data) + bounds.IndexOf(rect.x_begin, y),
                width * sizeof(uint32_t));
  }
  return words;
}

PlaneContext ContextOf(const PlaneView& view, const std::vector<Words>& known, int row_px) {
  PlaneContext context;
  context.is_float = view.is_float;
  context.row_px = row_px;
  if (view.like >= 0) context.other_half = known[static_cast<size_t>(view.like)];
  return context;
}

std::string Encode(const std::vector<PlaneView>& views, const PixelRect& bounds,
                   const PixelRect& rect) {
  const auto area = static_cast<size_t>(rect.area());
  std::vector<Words> known;
  Words codes(area);
  std::string raw;
  for (const PlaneView& view : views) {
    known.push_back(Cut(view, bounds, rect));
    const PlaneCoding coding =
        CodePlane(ContextOf(view, known, rect.width()), known.back(), kAbovePredictors, codes);
    raw.push_back(
        static_cast<char>(coding.width_bytes | (static_cast<uint8_t>(coding.predictor) << 3)));
    raw.push_back(static_cast<char>(coding.shift));
    raw.append(reinterpret_cast<const char*>(&coding.base), sizeof(coding.base));
    for (int byte = 0; byte < coding.width_bytes; ++byte) {
      raw.resize(raw.size() + area);
      SplitByte(codes, byte, raw.data() + raw.size() - area);
    }
  }
  std::string payload(ZSTD_compressBound(raw.size()), '\0');
  const size_t bytes =
      ZSTD_compress(payload.data(), payload.size(), raw.data(), raw.size(), kCompressionLevel);
  TESSERA_CHECK(!ZSTD_isError(bytes));
  payload.resize(bytes);
  return payload;
}

// Fills the planes, which are over one rectangle of rows of row_px pixels.
absl::Status Decode(const std::vector<PlaneView>& views, size_t area, int row_px,
                    std::string_view payload) {
  const size_t raw_max = views.size() * (kHeaderBytes + kPlaneBytesMax * area);
  const auto raw = std::make_unique_for_overwrite<char[]>(raw_max);
  const size_t raw_bytes = ZSTD_decompress(raw.get(), raw_max, payload.data(), payload.size());
  if (ZSTD_isError(raw_bytes)) return Malformed("they do not decompress");
  std::string_view rest(raw.get(), raw_bytes);
  std::vector<Words> known;
  Words codes(area);
  for (const PlaneView& view : views) {
    if (rest.size() < kHeaderBytes) return Malformed("too few bytes");
    PlaneCoding coding;
    const auto first = static_cast<uint8_t>(rest[0]);
    coding.width_bytes = first & 7;
    coding.predictor = static_cast<PlanePredictor>(first >> 3);
    coding.shift = static_cast<uint8_t>(rest[1]);
    std::memcpy(&coding.base, rest.data() + 2, sizeof(coding.base));
    rest.remove_prefix(kHeaderBytes);
    const PlaneContext context = ContextOf(view, known, row_px);
    if (coding.width_bytes > kPlaneBytesMax || coding.shift > 31 ||
        rest.size() < coding.width_bytes * area || !context.Allows(coding.predictor)) {
      return Malformed("a plane's header is impossible");
    }
    std::ranges::fill(codes, 0u);
    for (int byte = 0; byte < coding.width_bytes; ++byte) {
      JoinByte(rest.data(), byte, codes);
      rest.remove_prefix(area);
    }
    Words& words = known.emplace_back(area);
    RestorePlane(context, coding, codes, words);
    std::memcpy(view.data, words.data(), area * sizeof(uint32_t));
  }
  return rest.empty() ? absl::OkStatus() : Malformed("too many bytes");
}

}  // namespace

std::string EncodeFilterInput(const FramePlanes& planes, const PixelRect& bounds) {
  TESSERA_CHECK(!bounds.empty() && planes.bounds.Contains(bounds));
  return Encode(ViewsOf(const_cast<FramePlanes&>(planes)), planes.bounds, bounds);
}

absl::StatusOr<FramePlanes> DecodeFilterInput(const PixelRect& bounds, std::string_view payload) {
  if (bounds.empty()) return Malformed("no pixels");
  FramePlanes planes(bounds);
  absl::Status status = Decode(ViewsOf(planes), static_cast<size_t>(bounds.area()), bounds.width(),
                               payload);
  if (!status.ok()) return status;
  return planes;
}

std::string EncodeFiltered(const FilteredPlanes& filtered) {
  TESSERA_CHECK(!filtered.bounds.empty());
  return Encode(ViewsOf(const_cast<FilteredPlanes&>(filtered)), filtered.bounds, filtered.bounds);
}

absl::StatusOr<FilteredPlanes> DecodeFiltered(const PixelRect& window, std::string_view payload) {
  if (window.empty()) return Malformed("no pixels");
  FilteredPlanes planes(window);
  absl::Status status = Decode(ViewsOf(planes), static_cast<size_t>(window.area()), window.width(),
                               payload);
  if (!status.ok()) return status;
  return planes;
}

bool SameBits(const FilteredPlanes& a, const FilteredPlanes& b) {
  if (!(a.bounds == b.bounds)) return false;
  const auto bytes = static_cast<size_t>(a.bounds.area()) * sizeof(float);
  const auto of_a = ViewsOf(const_cast<FilteredPlanes&>(a));
  const auto of_b = ViewsOf(const_cast<FilteredPlanes&>(b));
  for (size_t i = 0; i < of_a.size(); ++i) {
    if (std::memcmp(of_a[i].data, of_b[i].data, bytes) != 0) return false;
  }
  return true;
}

uint64_t PayloadChecksum(std::string_view payload) {
  return XXH64(payload.data(), payload.size(), 0);
}

uint64_t FilteredChecksum(const FilteredKey& key, std::string_view payload) {
  const std::array<int64_t, 7> numbers = {
      static_cast<int64_t>(key.lease_id), static_cast<int64_t>(key.revision),
      key.window.x_begin, key.window.y_begin, key.window.x_end, key.window.y_end,
      static_cast<int64_t>(PayloadChecksum(payload))};
  std::string bytes(reinterpret_cast<const char*>(numbers.data()), sizeof(numbers));
  bytes += key.job;
  return XXH64(bytes.data(), bytes.size(), 0);
}

}  // namespace tessera
