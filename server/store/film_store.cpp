// Grammar: file = "TESFILM1" node* end; node = tile begin end (int64) encoding (uint32)
// size (uint32) payload; end = -1 as tile. Little-endian.
#include "server/store/film_store.h"

#include <bit>
#include <cstring>
#include <filesystem>
#include <fstream>

#include "absl/strings/str_cat.h"
#include "core/film/delta_codec.h"
#include "core/image/output_file.h"

namespace tessera {
namespace {

constexpr char kMagic[8] = {'T', 'E', 'S', 'F', 'I', 'L', 'M', '1'};
constexpr uint32_t kPayloadBytesMax = 1 << 20;
static_assert(std::endian::native == std::endian::little);

struct NodeHeader {
  int64_t tile = -1;
  int64_t begin = 0;
  int64_t end = 0;
  uint32_t encoding = 0;
  uint32_t payload_bytes = 0;
};
static_assert(sizeof(NodeHeader) == 32);

}  // namespace

absl::StatusOr<std::unique_ptr<FilmStore>> FilmStore::Open(const std::string& dir) {
  std::error_code error;
  std::filesystem::create_directories(dir, error);
  if (error) {
    return absl::PermissionDeniedError(absl::StrCat("cannot create ", dir, ": ", error.message(),
                                                    "; choose another --data-dir"));
  }
  std::unique_ptr<FilmStore> store(new FilmStore(dir));
  for (const auto& entry : std::filesystem::directory_iterator(dir, error)) {
    const auto size = static_cast<int64_t>(entry.file_size(error));
    if (!error) store->bytes_ += size;
  }
  return store;
}

int64_t FilmStore::BytesOf(uint64_t job) const {
  std::error_code missing;
  const std::uintmax_t size = std::filesystem::file_size(PathOf(job), missing);
  return missing ? 0 : static_cast<int64_t>(size);
}

std::string FilmStore::PathOf(uint64_t job) const { return absl::StrCat(dir_, "/", job, ".film"); }

absl::Status FilmStore::Save(uint64_t job, int64_t num_tiles, const NodeSource& nodes) const {
  absl::StatusOr<OutputFile> file = OutputFile::Create(PathOf(job));
  if (!file.ok()) return file.status();
  const auto append = [&](const void* data, size_t size) {
    file->WriteAt(file->size_bytes(), {static_cast<const std::byte*>(data), size});
  };
  append(kMagic, sizeof(kMagic));
  for (int64_t tile = 0; tile < num_tiles; ++tile) {
    for (const TileStatistics& node : nodes(tile)) {
      const EncodedDelta delta = EncodeDelta(node, DeltaEncoding::kPackedZstd);
      const NodeHeader header{tile, node.range().begin, node.range().end,
                              static_cast<uint32_t>(delta.encoding),
                              static_cast<uint32_t>(delta.payload.size())};
      append(&header, sizeof(header));
      append(delta.payload.data(), delta.payload.size());
    }
  }
  const NodeHeader end;
  append(&end, sizeof(end));
  const int64_t bytes_before = BytesOf(job);
  const absl::Status status = file->Commit();
  bytes_ += BytesOf(job) - bytes_before;
  return status;
}

absl::StatusOr<std::shared_ptr<Film>> FilmStore::Load(uint64_t job, const TileGrid& grid) const {
  const std::string path = PathOf(job);
  std::ifstream file(path, std::ios::binary);
  if (!file) return absl::NotFoundError(absl::StrCat(path, " does not exist"));
  const absl::Status damaged = absl::DataLossError(absl::StrCat(path, " is damaged"));
  char magic[sizeof(kMagic)];
  if (!file.read(magic, sizeof(magic)) || std::memcmp(magic, kMagic, sizeof(magic)) != 0) {
    return damaged;
  }
  auto film = std::make_shared<Film>(grid);
  NodeHeader header;
  std::string payload;
  while (file.read(reinterpret_cast<char*>(&header), sizeof(header))) {
    if (header.tile == -1) return film;
    const SampleRange range{header.begin, header.end};
    if (header.tile < 0 || header.tile >= grid.num_tiles() || range.begin < 0 || !range.IsNode() ||
        header.payload_bytes > kPayloadBytesMax) {
      return damaged;
    }
    payload.resize(header.payload_bytes);
    if (!file.read(payload.data(), header.payload_bytes)) return damaged;
    absl::StatusOr<TileStatistics> node =
        DecodeDelta(grid.WindowOf(header.tile), range, header.encoding, payload);
    if (!node.ok()) return damaged;
    if (!film->Accept(header.tile, *std::move(node)).ok()) return damaged;
  }
  return damaged;
}

void FilmStore::Remove(uint64_t job) const {
  const int64_t bytes_before = BytesOf(job);
  std::error_code ignored;
  if (std::filesystem::remove(PathOf(job), ignored)) bytes_ -= bytes_before;
}

}  // namespace tessera
