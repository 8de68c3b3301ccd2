#include "core/image/exr_writer.h"

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>

#include <algorithm>
#include <bit>
#include <cstring>
#include <memory>

#include "absl/strings/str_cat.h"
#include "core/image/output_file.h"

namespace tessera {
namespace {

constexpr int kRowsAtOnce = 64;  // four ZIP blocks, for the compressor's threads

// What OpenImageIO writes through; keeps errno, which OpenImageIO's own files lose.
class OutputFileProxy final : public OIIO::Filesystem::IOProxy {
 public:
  explicit OutputFileProxy(OutputFile* file) : IOProxy(file->path(), Write), file_(file) {}
  const char* proxytype() const override { return "tessera"; }
  size_t write(const void* bytes, size_t size) override {
    const size_t written = pwrite(bytes, size, m_pos);
    m_pos += static_cast<int64_t>(written);
    return written;
  }
  size_t pwrite(const void* bytes, size_t size, int64_t offset) override {
    const bool ok = file_->WriteAt(offset, {static_cast<const std::byte*>(bytes), size});
    return ok ? size : 0;
  }
  size_t size() const override { return static_cast<size_t>(file_->size_bytes()); }

 private:
  OutputFile* file_;
};

void SetMetadata(const Metadata& metadata, OIIO::ImageSpec* spec) {
  for (const auto& [key, value] : metadata) {
    const std::string name = absl::StrCat("tessera:", key);
    if (const auto* text = std::get_if<std::string>(&value)) {
      spec->attribute(name, *text);
    } else if (const auto* number = std::get_if<double>(&value)) {
      spec->attribute(name, OIIO::TypeDesc::DOUBLE, number);
    } else {
      const int64_t integer = std::get<int64_t>(value);
      if (integer == static_cast<int>(integer)) {
        spec->attribute(name, static_cast<int>(integer));
      } else {
        spec->attribute(name, absl::StrCat(integer));  // EXR has no 64-bit integers
      }
    }
  }
}

OIIO::ImageSpec MakeSpec(const ExrHeader& header) {
  const PixelRect& data = header.data_window;
  const PixelRect& display = header.display_window;
  OIIO::ImageSpec spec(data.width(), data.height(), static_cast<int>(header.channels.size()),
                       OIIO::TypeDesc::FLOAT);
  spec.x = data.x_begin;
  spec.y = data.y_begin;
  spec.full_x = display.x_begin;
  spec.full_y = display.y_begin;
  spec.full_width = display.width();
  spec.full_height = display.height();
  spec.channelnames.clear();
  for (const ExrChannel& channel : header.channels) {
    spec.channelnames.push_back(channel.name);
    spec.channelformats.push_back(channel.is_uint ? OIIO::TypeDesc::UINT : OIIO::TypeDesc::FLOAT);
  }
  spec.attribute("compression", "zip");
  spec.attribute("oiio:ColorSpace", "Linear");
  SetMetadata(header.metadata, &spec);
  return spec;
}

}  // namespace

absl::Status WriteExr(const std::string& path, const ExrHeader& header,
                      const ExrRowSource& fill_rows) {
  if (header.data_window.empty() || header.channels.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat("cannot write ", path,
                     ": the picture is empty; ask for at least one pixel "
                     "and one layer"));
  }
  absl::StatusOr<OutputFile> file = OutputFile::Create(path);
  if (!file.ok()) return file.status();
  OutputFileProxy proxy(&*file);
  std::unique_ptr<OIIO::ImageOutput> output = OIIO::ImageOutput::create("openexr");
  if (!output) return absl::InternalError("OpenImageIO was built without OpenEXR; install it");
  output->set_ioproxy(&proxy);
  bool ok = output->open(absl::StrCat(path, ".exr"), MakeSpec(header));
  const PixelRect& data = header.data_window;
  const size_t row_words = header.channels.size() * static_cast<size_t>(data.width());
  std::vector<uint32_t> words(row_words * std::min(kRowsAtOnce, data.height()));
  for (int y = data.y_begin; ok && y < data.y_end; y += kRowsAtOnce) {
    const int y_end = std::min(y + kRowsAtOnce, data.y_end);
    fill_rows(y, y_end, std::span(words).first(row_words * static_cast<size_t>(y_end - y)));
    ok = output->write_scanlines(y, y_end, 0, OIIO::TypeDesc::UNKNOWN, words.data());
  }
  ok = output->close() && ok;
  const std::string codec_error = output->geterror();
  const absl::Status committed = ok ? file->Commit() : file->Discard();
  if (!committed.ok() || ok) return committed;
  return absl::UnavailableError(absl::StrCat("cannot write ", path, ": ", codec_error));
}

absl::Status WriteExr(const std::string& path, const Image& image) {
  ExrHeader header{image.data_window, image.display_window, {}, image.metadata};
  for (const ImageChannel& channel : image.channels) {
    header.channels.push_back({channel.name, channel.is_uint});
  }
  const size_t num_channels = image.channels.size();
  return WriteExr(path, header, [&](int y_begin, int y_end, std::span<uint32_t> words) {
    const int64_t first = image.data_window.IndexOf(image.data_window.x_begin, y_begin);
    const int64_t num_pixels = int64_t{y_end - y_begin} * image.width();
    for (size_t c = 0; c < num_channels; ++c) {
      const ImageChannel& channel = image.channels[c];
      for (int64_t i = 0; i < num_pixels; ++i) {
        words[static_cast<size_t>(i) * num_channels + c] =
            channel.is_uint ? channel.uints[first + i]
                            : std::bit_cast<uint32_t>(channel.floats[first + i]);
      }
    }
  });
}

}  // namespace tessera
