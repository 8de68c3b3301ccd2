// Grammar: file = "TESFILM3" tile* end contributions sha256; tile = index (int64, ascending) rays
// delta_bytes render_ns (int64) num_nodes (uint32) 0 (uint32) node*; node = begin end (int64)
// encoding (uint32) size (uint32) payload; end = a tile of index -1 without nodes; contributions =
// size (uint64) payload; sha256 = of all before it. Tiles without nodes are left out.
// Little-endian. Files of "TESFILM2" have no contributions, and are read as well.
#include "server/store/film_store.h"

#include <fcntl.h>
#include <unistd.h>

#include <bit>
#include <charconv>
#include <cstring>
#include <filesystem>
#include <fstream>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "core/base/sha256.h"
#include "core/film/delta_codec.h"
#include "core/image/output_file.h"

namespace tessera {
namespace {

namespace fs = std::filesystem;

constexpr char kMagic[8] = {'T', 'E', 'S', 'F', 'I', 'L', 'M', '3'};
constexpr char kMagicBefore[8] = {'T', 'E', 'S', 'F', 'I', 'L', 'M', '2'};
constexpr uint64_t kContributionBytesMax = uint64_t{1} << 30;
constexpr char kEnding[] = ".film";
constexpr char kTemporary[] = ".tmp-";  // OutputFile's
constexpr uint32_t kPayloadBytesMax = 1 << 20;
static_assert(std::endian::native == std::endian::little);

struct TileHeader {
  int64_t tile = -1;
  int64_t rays = 0;
  int64_t delta_bytes = 0;
  int64_t render_ns = 0;
  uint32_t num_nodes = 0;
  uint32_t zero = 0;
};
static_assert(sizeof(TileHeader) == 40);

struct NodeHeader {
  int64_t begin = 0;
  int64_t end = 0;
  uint32_t encoding = 0;
  uint32_t payload_bytes = 0;
};
static_assert(sizeof(NodeHeader) == 24);

// Reads and hashes. After the first read that fails, all fail.
class HashedReader {
 public:
  explicit HashedReader(const std::string& path) : file_(path, std::ios::binary) {}
  bool is_open() const { return file_.is_open(); }
  bool Read(void* data, size_t size) {
    if (!file_.read(static_cast<char*>(data), static_cast<std::streamsize>(size))) return false;
    hash_.Update(std::string_view(static_cast<const char*>(data), size));
    return true;
  }
  // Whether the file ends here with the hash of what has been read.
  bool EndsWithHash() {
    const Sha256Digest expected = hash_.Finish();
    Sha256Digest stored{};
    file_.read(reinterpret_cast<char*>(stored.data()), stored.size());
    return file_ && stored == expected && file_.peek() == std::ifstream::traits_type::eof();
  }

 private:
  std::ifstream file_;
  Sha256 hash_;
};

bool ReadNode(HashedReader& file, const PixelRect& window, int64_t feature_end,
              std::string& payload, TileStatistics* node) {
  NodeHeader header;
  if (!file.Read(&header, sizeof(header))) return false;
  const SampleRange range{header.begin, header.end};
  if (!range.IsNode() || range.end > kSamplesMax || header.payload_bytes > kPayloadBytesMax) {
    return false;
  }
  payload.resize(header.payload_bytes);
  if (!file.Read(payload.data(), payload.size())) return false;
  absl::StatusOr<TileStatistics> decoded =
      DecodeDelta(window, range, feature_end, header.encoding, payload);
  if (!decoded.ok()) return false;
  *node = *std::move(decoded);
  return true;
}

bool ReadContributions(HashedReader& file, std::string* contributions) {
  uint64_t size = 0;
  if (!file.Read(&size, sizeof(size)) || size > kContributionBytesMax) return false;
  contributions->resize(size);
  return size == 0 || file.Read(contributions->data(), size);
}

bool ReadFilm(HashedReader& file, const TileGrid& grid, int64_t feature_end, StoredFilm* stored) {
  char magic[sizeof(kMagic)];
  if (!file.Read(magic, sizeof(magic))) return false;
  const bool is_new = std::memcmp(magic, kMagic, sizeof(magic)) == 0;
  if (!is_new && std::memcmp(magic, kMagicBefore, sizeof(magic)) != 0) return false;
  stored->film = std::make_shared<Film>(grid, feature_end);
  stored->costs.resize(static_cast<size_t>(grid.num_tiles()));
  TileHeader header;
  std::string payload;
  TileStatistics node;
  int64_t last = -1;
  while (file.Read(&header, sizeof(header))) {
    if (header.tile == -1) {
      return (!is_new || ReadContributions(file, &stored->contributions)) && file.EndsWithHash();
    }
    if (header.tile <= last || header.tile >= grid.num_tiles() || header.rays < 0 ||
        header.delta_bytes < 0 || header.render_ns < 0) {
      return false;
    }
    last = header.tile;
    stored->costs[static_cast<size_t>(last)] = {header.rays, header.delta_bytes, header.render_ns};
    for (uint32_t i = 0; i < header.num_nodes; ++i) {
      if (!ReadNode(file, grid.WindowOf(last), feature_end, payload, &node) ||
          !stored->film->Accept(last, std::move(node)).ok()) {
        return false;
      }
    }
  }
  return false;
}

// Makes the renaming of a file in the folder survive a loss of power.
void SyncFolder(const std::string& dir) {
  const int descriptor = open(dir.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (descriptor < 0) return;
  fsync(descriptor);
  close(descriptor);
}

}  // namespace

absl::StatusOr<std::unique_ptr<FilmStore>> FilmStore::Open(const std::string& dir) {
  std::error_code error;
  fs::create_directories(dir, error);
  if (error) {
    return absl::PermissionDeniedError(absl::StrCat("cannot create ", dir, ": ", error.message(),
                                                    "; choose another --data-dir"));
  }
  std::unique_ptr<FilmStore> store(new FilmStore(dir));
  std::vector<fs::path> half_written;
  for (const auto& entry : fs::directory_iterator(dir, error)) {
    std::error_code size_error;
    const auto size = static_cast<int64_t>(entry.file_size(size_error));
    if (absl::StrContains(entry.path().filename().string(), kTemporary)) {
      half_written.push_back(entry.path());
    } else if (!size_error) {
      store->bytes_ += size;
    }
  }
  if (error) return absl::PermissionDeniedError(absl::StrCat("cannot read ", dir));
  for (const fs::path& path : half_written) fs::remove(path, error);
  return store;
}

int64_t FilmStore::BytesOf(uint64_t job) const {
  std::error_code missing;
  const std::uintmax_t size = fs::file_size(PathOf(job), missing);
  return missing ? 0 : static_cast<int64_t>(size);
}

std::string FilmStore::PathOf(uint64_t job) const { return absl::StrCat(dir_, "/", job, kEnding); }

absl::Status FilmStore::Save(uint64_t job, int64_t num_tiles, const TileSource& source,
                             const ContributionSource& contributions) const {
  absl::StatusOr<OutputFile> file = OutputFile::Create(PathOf(job));
  if (!file.ok()) return file.status();
  Sha256 hash;
  bool is_written = true;
  const auto append = [&](const void* data, size_t size) {
    hash.Update(std::string_view(static_cast<const char*>(data), size));
    is_written = file->WriteAt(file->size_bytes(), {static_cast<const std::byte*>(data), size});
  };
  append(kMagic, sizeof(kMagic));
  for (int64_t index = 0; index < num_tiles && is_written; ++index) {
    const Tile tile = source(index);
    if (tile.nodes.empty()) continue;
    const TileHeader tile_header{index, tile.cost.rays, tile.cost.delta_bytes, tile.cost.render_ns,
                                 static_cast<uint32_t>(tile.nodes.size()), 0};
    append(&tile_header, sizeof(tile_header));
    for (const TileStatistics& node : tile.nodes) {
      const EncodedDelta delta = EncodeDelta(node, DeltaEncoding::kPackedZstd);
      const NodeHeader header{node.range().begin, node.range().end,
                              static_cast<uint32_t>(delta.encoding),
                              static_cast<uint32_t>(delta.payload.size())};
      append(&header, sizeof(header));
      append(delta.payload.data(), delta.payload.size());
    }
  }
  const TileHeader end;
  append(&end, sizeof(end));
  const std::optional<std::string> who = contributions ? contributions() : "";
  if (!who) return absl::AbortedError("the film has lost samples while it was written");
  const uint64_t who_bytes = who->size();
  append(&who_bytes, sizeof(who_bytes));
  append(who->data(), who->size());
  const Sha256Digest digest = hash.Finish();
  file->WriteAt(file->size_bytes(), std::as_bytes(std::span(digest)));
  const int64_t bytes_before = BytesOf(job);
  const absl::Status status = file->Commit();
  bytes_ += BytesOf(job) - bytes_before;
  if (status.ok()) SyncFolder(dir_);
  return status;
}

absl::StatusOr<StoredFilm> FilmStore::Load(uint64_t job, const TileGrid& grid,
                                           int64_t feature_end) const {
  const std::string path = PathOf(job);
  HashedReader file(path);
  if (!file.is_open()) return absl::NotFoundError(absl::StrCat(path, " does not exist"));
  StoredFilm stored;
  if (ReadFilm(file, grid, feature_end, &stored)) return stored;
  return absl::DataLossError(absl::StrCat(path, " is damaged, or of another version"));
}

void FilmStore::Remove(uint64_t job) const {
  const int64_t bytes_before = BytesOf(job);
  std::error_code ignored;
  if (fs::remove(PathOf(job), ignored)) bytes_ -= bytes_before;
}

int FilmStore::RemoveAllBut(const std::set<uint64_t>& jobs) const {
  std::vector<uint64_t> orphans;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(dir_, error)) {
    if (entry.path().extension() != kEnding) continue;
    const std::string name = entry.path().stem().string();
    const char* const end = name.data() + name.size();
    uint64_t job = 0;
    const bool is_name =
        std::from_chars(name.data(), end, job) == std::from_chars_result{end, std::errc()};
    if (is_name && !jobs.contains(job)) orphans.push_back(job);
  }
  for (const uint64_t job : orphans) Remove(job);
  return static_cast<int>(orphans.size());
}

}  // namespace tessera
