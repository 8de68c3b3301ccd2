#include "core/image/film_file.h"

#include <algorithm>
#include <array>
#include <bit>
#include <map>
#include <utility>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "core/film/delta_codec.h"
#include "core/film/fold.h"
#include "core/image/exr_writer.h"
#include "core/image/image_input.h"

namespace tessera {
namespace {

constexpr char kVersionKey[] = "film.version";
constexpr int64_t kVersion = 2;
constexpr char kSettingsKey[] = "film.settings";
constexpr char kFeatureSppKey[] = "film.feature_spp";
constexpr char kNonFiniteKey[] = "film.non_finite";
constexpr int kRowsAtOnce = 64;
constexpr int kRowsOfChunk = 16;                    // what OpenEXR unpacks at once
constexpr int64_t kBandBytesMax = int64_t{1} << 28;  // of whichever bytes_max
constexpr int64_t kNodeOverheadBytes = 512;         // bounds, window, vectors' heads

constexpr std::array<const char*, kNumFloatPlanes> kFloatNames = {
    "radiance.mean.R", "radiance.mean.G", "radiance.mean.B", "radiance.msd.R", "radiance.msd.G",
    "radiance.msd.B",  "albedo.mean.R",   "albedo.mean.G",   "albedo.mean.B",  "albedo.msd.R",
    "albedo.msd.G",    "albedo.msd.B",    "normal.mean.X",   "normal.mean.Y",  "normal.mean.Z",
    "normal.msd.X",    "normal.msd.Y",    "normal.msd.Z",    "depth.mean",     "depth.msd"};
constexpr std::array<const char*, kNumCountPlanes> kCountNames = {"later_hits", "hits", "id",
                                                                  "votes"};

// One channel of a group: which plane of a node it holds.
struct FilmChannel {
  std::string name;  // after the group's prefix
  bool is_uint;
  int half;
  int plane;
};

std::vector<FilmChannel> MakeChannels(int num_float_planes, int num_count_planes) {
  std::vector<FilmChannel> channels;
  for (int half = 0; half < kNumHalves; ++half) {
    const char* prefix = half == 0 ? "A." : "B.";
    for (int plane = 0; plane < num_float_planes; ++plane) {
      channels.push_back({absl::StrCat(prefix, kFloatNames[plane]), false, half, plane});
    }
    for (int plane = 0; plane < num_count_planes; ++plane) {
      channels.push_back({absl::StrCat(prefix, kCountNames[plane]), true, half, plane});
    }
  }
  return channels;
}

// The order of a group's channels; the node channel comes before them.
const std::vector<FilmChannel>& ChannelsOfGroup(bool has_features) {
  static const std::vector<FilmChannel> kAll = MakeChannels(kNumFloatPlanes, kNumCountPlanes);
  static const std::vector<FilmChannel> kLater =
      MakeChannels(kNumRadiancePlanes, kNumLaterCountPlanes);
  return has_features ? kAll : kLater;
}

std::string GroupPrefix(SampleRange range) {
  return absl::StrCat("film.", range.begin, "-", range.end, ".");
}

// Nodes of a film by sample range, ascending.
using Groups = std::map<SampleRange, std::vector<const TileStatistics*>>;

// Whether two of the nodes share a pixel; all lie inside `region`.
bool Overlap(const std::vector<const TileStatistics*>& nodes, const PixelRect& region) {
  std::vector<bool> covered(static_cast<size_t>(region.area()));
  for (const TileStatistics* node : nodes) {
    const PixelRect& window = node->window();
    for (int y = window.y_begin; y < window.y_end; ++y) {
      for (int x = window.x_begin; x < window.x_end; ++x) {
        auto pixel = covered[static_cast<size_t>(region.IndexOf(x, y))];
        if (pixel) return true;
        pixel = true;
      }
    }
  }
  return false;
}

absl::StatusOr<Groups> GroupNodes(const FilmFile& film, const PixelRect& region) {
  Groups groups;
  for (const TileStatistics& node : film.nodes) {
    if (node.window().empty() || !region.Contains(node.window()) || node.range().empty()) {
      return absl::InvalidArgumentError("a node of the film lies outside the picture");
    }
    if (node.feature_end() != film.feature_end) {
      return absl::InvalidArgumentError("the nodes of the film carry features of other samples");
    }
    groups[node.range()].push_back(&node);
  }
  if (groups.size() > kFilmRangesMax) {
    return absl::InvalidArgumentError(
        absl::StrCat("the film has ", groups.size(), " different sample ranges, more than ",
                     kFilmRangesMax, "; let the render reach a power of two of samples"));
  }
  for (const auto& [range, nodes] : groups) {
    if (Overlap(nodes, region)) {
      return absl::InvalidArgumentError(
          absl::StrCat("two nodes of samples ", range.begin, " to ", range.end, " overlap"));
    }
  }
  return groups;
}

// A band of rows being filled or read: interleaved channels of 32 bits.
struct Band {
  int y_begin;
  int y_end;
  PixelRect region;
  size_t num_channels;
  std::span<uint32_t> words;

  uint32_t& At(int x, int y, size_t channel) const {
    const PixelRect rows{region.x_begin, y_begin, region.x_end, y_end};
    return words[static_cast<size_t>(rows.IndexOf(x, y)) * num_channels + channel];
  }
};

// Calls visit(word, c, pixel) for each value of a node in the band: c counts `places` (0 is the
// node channel), pixel is row-major in the node's window.
template <typename Visit>
void ForEachWord(const PixelRect& window, const Band& band, std::span<const size_t> places,
                 const Visit& visit) {
  const int y_begin = std::max(window.y_begin, band.y_begin);
  const int y_end = std::min(window.y_end, band.y_end);
  for (int y = y_begin; y < y_end; ++y) {
    for (int x = window.x_begin; x < window.x_end; ++x) {
      const size_t pixel = static_cast<size_t>(window.IndexOf(x, y));
      uint32_t* words = &band.At(x, y, 0);
      for (size_t c = 0; c < places.size(); ++c) visit(words[places[c]], c, pixel);
    }
  }
}

void PutNode(const TileStatistics& node, uint32_t ordinal, const Band& band,
             std::span<const size_t> places) {
  const std::vector<FilmChannel>& channels = ChannelsOfGroup(node.has_features());
  ForEachWord(node.window(), band, places, [&](uint32_t& word, size_t c, size_t pixel) {
    if (c == 0) {
      word = ordinal;
      return;
    }
    const FilmChannel& channel = channels[c - 1];
    if (channel.is_uint) {
      word = node.Counts(channel.half, channel.plane)[pixel];
    } else {
      word = std::bit_cast<uint32_t>(node.Floats(channel.half, channel.plane)[pixel]);
    }
  });
}

void TakeNode(const Band& band, std::span<const size_t> places, TileStatistics* node) {
  const std::vector<FilmChannel>& channels = ChannelsOfGroup(node->has_features());
  ForEachWord(node->window(), band, places, [&](uint32_t word, size_t c, size_t pixel) {
    if (c == 0) return;
    const FilmChannel& channel = channels[c - 1];
    if (channel.is_uint) {
      node->MutableCounts(channel.half, channel.plane)[pixel] = word;
    } else {
      node->MutableFloats(channel.half, channel.plane)[pixel] = std::bit_cast<float>(word);
    }
  });
}

void PutPicture(const Image& picture, const Band& band) {
  for (size_t c = 0; c < picture.channels.size(); ++c) {
    const ImageChannel& channel = picture.channels[c];
    int64_t i = picture.data_window.IndexOf(band.region.x_begin, band.y_begin);
    for (int y = band.y_begin; y < band.y_end; ++y) {
      for (int x = band.region.x_begin; x < band.region.x_end; ++x, ++i) {
        band.At(x, y, c) =
            channel.is_uint ? channel.uints[i] : std::bit_cast<uint32_t>(channel.floats[i]);
      }
    }
  }
}

// The channels of one sample range in a file that is being read.
struct GroupLayout {
  SampleRange range;
  std::vector<size_t> places;  // index of the node channel, then of ChannelsOfGroup()
};

// What is known of a node before its planes are read.
struct NodeBounds {
  size_t group;
  PixelRect window;
  int64_t num_pixels = 0;
};

// Empty if there is no such text: EXR files do not keep empty ones.
std::string TextOf(const Metadata& metadata, std::string_view key) {
  const auto found = metadata.find(key);
  if (found == metadata.end()) return "";
  const std::string* text = std::get_if<std::string>(&found->second);
  return text == nullptr ? "" : *text;
}

absl::Status CheckVersion(const std::string& path, const Metadata& metadata) {
  const auto found = metadata.find(std::string_view(kVersionKey));
  if (found == metadata.end()) {
    return absl::FailedPreconditionError(
        absl::StrCat(path, ": the image holds no film; write one with --layers film"));
  }
  const int64_t* version = std::get_if<int64_t>(&found->second);
  if (version == nullptr || *version != kVersion) {
    return absl::FailedPreconditionError(absl::StrCat(
        path, ": a film of another version of the program; read it with that version"));
  }
  return absl::OkStatus();
}

class FilmReader {
 public:
  FilmReader(const std::string& path, int64_t bytes_max, OIIO::ImageInput* input)
      : path_(path), bytes_max_(bytes_max), input_(*input) {
    region_ = DataWindow(input_.spec());
  }

  absl::StatusOr<FilmFile> Read() {
    FilmFile film;
    film.region = region_;
    film.frame = DisplayWindow(input_.spec());
    const Metadata metadata = ReadMetadata(input_.spec());
    absl::Status status = CheckVersion(path_, metadata);
    if (!status.ok()) return status;
    film.settings = TextOf(metadata, kSettingsKey);
    film.version = TextOf(metadata, "version");
    const auto feature_spp = metadata.find(std::string_view(kFeatureSppKey));
    if (feature_spp != metadata.end()) {
      const int64_t* value = std::get_if<int64_t>(&feature_spp->second);
      feature_end_ = FeatureEndOf(value == nullptr ? -1 : *value);
    }
    if (!IsFeatureEnd(feature_end_)) return DamagedImage(path_, kFeatureSppKey);
    film.feature_end = feature_end_;
    status = FindGroups();
    if (status.ok() && BytesOfRows(kRowsOfChunk) > std::max(bytes_max_, kBandBytesMax)) {
      status = TooLarge();
    }
    if (status.ok()) status = ForEachBand([this](const Band& band) { return FindNodes(band); });
    if (status.ok()) status = MakeNodes(&film);
    if (status.ok()) {
      status = ForEachBand([&](const Band& band) {
        for (size_t n = 0; n < film.nodes.size(); ++n) {
          TakeNode(band, groups_[bounds_[n].group].places, &film.nodes[n]);
        }
        return absl::OkStatus();
      });
    }
    if (status.ok()) status = SetNonFinite(TextOf(metadata, kNonFiniteKey), &film);
    for (const TileStatistics& node : film.nodes) {
      if (status.ok() && !ValidateStatistics(node).ok()) {
        status = DamagedImage(path_, "values that no film can have");
      }
    }
    if (!status.ok()) return status;
    return film;
  }

 private:
  absl::Status TooLarge() const {
    return absl::InvalidArgumentError(
        absl::StrCat(path_, ": the film needs more than the ", bytes_max_ >> 20,
                     " MiB that one of its size and purpose may take; write it anew with --layers "
                     "film"));
  }

  int64_t BytesOfRows(int rows) const {
    return int64_t{rows} * region_.width() * input_.spec().nchannels *
           static_cast<int64_t>(sizeof(uint32_t));
  }

  absl::Status FindGroups() {
    const OIIO::ImageSpec& spec = input_.spec();
    std::map<std::string, size_t> channels;
    for (int c = 0; c < spec.nchannels; ++c) channels[spec.channelnames[c]] = c;
    std::map<SampleRange, GroupLayout> groups;
    for (const auto& [name, index] : channels) {
      const std::vector<std::string> parts = absl::StrSplit(name, '.');
      if (parts.size() != 3 || parts[0] != "film" || parts[2] != "node") continue;
      const std::vector<std::string> ends = absl::StrSplit(parts[1], '-');
      GroupLayout group;
      if (ends.size() != 2 || !absl::SimpleAtoi(ends[0], &group.range.begin) ||
          !absl::SimpleAtoi(ends[1], &group.range.end) || group.range.begin < 0 ||
          group.range.end > kSamplesMax || !group.range.IsNode()) {
        return DamagedImage(path_, absl::StrCat("channel ", name));
      }
      group.places.push_back(index);
      for (const FilmChannel& channel : ChannelsOfGroup(group.range.begin < feature_end_)) {
        const auto found = channels.find(absl::StrCat(GroupPrefix(group.range), channel.name));
        if (found == channels.end()) {
          return DamagedImage(path_,
                              absl::StrCat("no channel ", GroupPrefix(group.range), channel.name));
        }
        group.places.push_back(found->second);
      }
      groups[group.range] = std::move(group);
    }
    if (groups.size() > kFilmRangesMax) return DamagedImage(path_, "too many sample ranges");
    for (auto& [range, group] : groups) groups_.push_back(std::move(group));
    for (int c = 0; c < spec.nchannels; ++c) {
      const bool is_film = spec.channelnames[c].starts_with("film.");
      if (is_film && spec.channelformat(c).size() != sizeof(uint32_t)) {
        return DamagedImage(path_, "a film's channel that is not of 32 bits");
      }
    }
    return absl::OkStatus();
  }

  // Grows the bounds of the nodes that the band shows.
  absl::Status FindNodes(const Band& band) {
    for (size_t g = 0; g < groups_.size(); ++g) {
      const size_t place = groups_[g].places[0];
      for (int y = band.y_begin; y < band.y_end; ++y) {
        for (int x = region_.x_begin; x < region_.x_end; ++x) {
          const uint32_t ordinal = band.At(x, y, place);
          if (ordinal == 0) continue;
          if (ordinal > static_cast<uint64_t>(region_.area()) * groups_.size()) {
            return DamagedImage(path_, "a node's number is too large");
          }
          const PixelRect pixel{x, y, x + 1, y + 1};
          auto [found, is_new] = found_.try_emplace(ordinal, NodeBounds{g, pixel});
          NodeBounds& node = found->second;
          if (is_new && std::ssize(found_) > bytes_max_ / kNodeOverheadBytes) return TooLarge();
          if (node.group != g) return DamagedImage(path_, "a node with two sample ranges");
          node.window = {std::min(node.window.x_begin, x), std::min(node.window.y_begin, y),
                         std::max(node.window.x_end, x + 1), std::max(node.window.y_end, y + 1)};
          ++node.num_pixels;
        }
      }
    }
    return absl::OkStatus();
  }

  absl::Status MakeNodes(FilmFile* film) {
    uint32_t expected = 1;
    int64_t bytes = 0;
    for (const auto& [ordinal, node] : found_) {
      bytes += kNodeOverheadBytes + node.num_pixels * std::ssize(groups_[node.group].places) *
                                        static_cast<int64_t>(sizeof(uint32_t));
    }
    if (bytes > bytes_max_) return TooLarge();
    for (const auto& [ordinal, node] : found_) {
      if (ordinal != expected++) return DamagedImage(path_, "a node is missing");
      if (node.window.area() != node.num_pixels) {
        return DamagedImage(path_, "a node that is no rectangle");
      }
      bounds_.push_back(node);
      film->nodes.emplace_back(node.window, groups_[node.group].range, feature_end_);
    }
    return absl::OkStatus();
  }

  absl::Status SetNonFinite(const std::string& text, FilmFile* film) {
    for (absl::string_view entry : absl::StrSplit(text, ',', absl::SkipEmpty())) {
      const std::vector<std::string> parts = absl::StrSplit(entry, ':');
      uint64_t ordinal;
      int64_t count;
      if (parts.size() != 2 || !absl::SimpleAtoi(parts[0], &ordinal) ||
          !absl::SimpleAtoi(parts[1], &count) || ordinal < 1 || ordinal > film->nodes.size()) {
        return DamagedImage(path_, "the counts of non-finite samples");
      }
      film->nodes[ordinal - 1].non_finite = count;
    }
    return absl::OkStatus();
  }

  template <typename Visit>
  absl::Status ForEachBand(const Visit& visit) {
    const size_t num_channels = static_cast<size_t>(input_.spec().nchannels);
    const int rows = BytesOfRows(kRowsAtOnce) > kBandBytesMax ? kRowsOfChunk : kRowsAtOnce;
    std::vector<uint32_t> words(num_channels * static_cast<size_t>(region_.width()) *
                                static_cast<size_t>(rows));
    for (int y = region_.y_begin; y < region_.y_end; y += rows) {
      const int y_end = std::min(y + rows, region_.y_end);
      if (!input_.read_scanlines(0, 0, y, y_end, 0, 0, input_.spec().nchannels,
                                 OIIO::TypeDesc::UNKNOWN, words.data())) {
        return DamagedImage(path_, input_.geterror());
      }
      const absl::Status status = visit(Band{y, y_end, region_, num_channels, words});
      if (!status.ok()) return status;
    }
    return absl::OkStatus();
  }

  const std::string path_;
  const int64_t bytes_max_;
  OIIO::ImageInput& input_;
  PixelRect region_;
  int64_t feature_end_ = kAllFeatures;
  std::vector<GroupLayout> groups_;       // ascending by range
  std::map<uint32_t, NodeBounds> found_;  // by ordinal
  std::vector<NodeBounds> bounds_;        // of film->nodes
};

}  // namespace

absl::Status WriteFilmFile(const std::string& path, const FilmFile& film, const Image& picture) {
  const PixelRect& region = picture.data_window;
  const absl::StatusOr<Groups> groups = GroupNodes(film, region);
  if (!groups.ok()) {
    return absl::InvalidArgumentError(
        absl::StrCat("cannot write ", path, ": ", groups.status().message()));
  }
  ExrHeader header{region, picture.display_window, {}, picture.metadata};
  for (const ImageChannel& channel : picture.channels) {
    header.channels.push_back({channel.name, channel.is_uint});
  }
  std::string non_finite;
  uint32_t ordinal = 0;
  for (const auto& [range, nodes] : *groups) {
    header.channels.push_back({absl::StrCat(GroupPrefix(range), "node"), true});
    for (const FilmChannel& channel : ChannelsOfGroup(nodes.front()->has_features())) {
      header.channels.push_back({absl::StrCat(GroupPrefix(range), channel.name), channel.is_uint});
    }
    for (const TileStatistics* node : nodes) {
      ++ordinal;
      if (node->non_finite != 0) {
        absl::StrAppend(&non_finite, non_finite.empty() ? "" : ",", ordinal, ":", node->non_finite);
      }
    }
  }
  header.metadata[kVersionKey] = kVersion;
  header.metadata[kSettingsKey] = film.settings;
  header.metadata[kFeatureSppKey] = FeatureSppOf(film.feature_end);
  if (!non_finite.empty()) header.metadata[kNonFiniteKey] = non_finite;
  return WriteExr(path, header, [&](int y_begin, int y_end, std::span<uint32_t> words) {
    const Band band{y_begin, y_end, region, header.channels.size(), words};
    std::ranges::fill(words, 0);
    PutPicture(picture, band);
    size_t place = picture.channels.size();
    uint32_t node_ordinal = 0;
    for (const auto& [range, nodes] : *groups) {
      std::vector<size_t> places(ChannelsOfGroup(nodes.front()->has_features()).size() + 1);
      for (size_t& channel : places) channel = place++;
      for (const TileStatistics* node : nodes) PutNode(*node, ++node_ordinal, band, places);
    }
  });
}

absl::StatusOr<FilmFile> ReadFilmFile(const std::string& path, const FilmReadLimits& limits) {
  absl::StatusOr<OpenedImage> opened = OpenImage(path, limits.image);
  if (!opened.ok()) return opened.status();
  if (opened->format != "openexr" || opened->input->spec().tile_width != 0) {
    return absl::FailedPreconditionError(
        absl::StrCat(path, ": the image holds no film; write one with --layers film"));
  }
  return FilmReader(path, limits.bytes_max, opened->input.get()).Read();
}

}  // namespace tessera
