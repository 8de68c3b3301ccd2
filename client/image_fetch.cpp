// FarmClient::GetImage: planes in chunks, assembled into an Image.
#include <algorithm>
#include <bit>
#include <cstring>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/farm_client.h"

namespace tessera {
namespace {

static_assert(std::endian::native == std::endian::little, "planes travel as little-endian words");

constexpr int kSideMax = 1 << 16;
constexpr int kChannelsMax = 256;

// Puts chunks of words, cut anywhere, into the channels of an image one after the other. Memory
// grows with what has arrived, not with what a header claims.
class ImageAssembler {
 public:
  absl::Status Begin(const v1::ImageHeader& header) {
    const v1::Region& region = header.region();
    const PixelRect frame = PixelRect::FromSize(0, 0, header.frame_width(), header.frame_height());
    if (frame.empty() || frame.x_end > kSideMax || frame.y_end > kSideMax || region.x() < 0 ||
        region.y() < 0 || region.width() < 1 || region.height() < 1 ||
        region.width() > kSideMax || region.height() > kSideMax) {
      return absl::InternalError("the server sent a picture of an impossible size");
    }
    image_.display_window = frame;
    image_.data_window =
        PixelRect::FromSize(region.x(), region.y(), region.width(), region.height());
    if (!frame.Contains(image_.data_window)) {
      return absl::InternalError("the server sent a region outside the frame");
    }
    for (const v1::ImageLayer& layer : header.layers()) {
      for (const std::string& channel : layer.channels()) {
        image_.channels.push_back({channel, layer.is_uint(), {}, {}});
      }
    }
    if (image_.channels.size() > kChannelsMax) {
      return absl::InternalError("the server sent too many channels");
    }
    begun_ = true;
    return absl::OkStatus();
  }

  absl::Status Append(std::string_view chunk) {
    if (!begun_) return absl::InternalError("the server sent pixels without a header");
    while (!chunk.empty()) {
      // Complete the word that the previous chunk cut.
      const size_t take = std::min(sizeof(uint32_t) - partial_bytes_, chunk.size());
      std::memcpy(partial_ + partial_bytes_, chunk.data(), take);
      partial_bytes_ += take;
      chunk.remove_prefix(take);
      if (partial_bytes_ < sizeof(uint32_t)) break;
      partial_bytes_ = 0;
      uint32_t word = 0;
      std::memcpy(&word, partial_, sizeof(word));
      if (channel_ == image_.channels.size()) {
        return absl::InternalError("the server sent more pixels than it promised");
      }
      PutWord(word);
    }
    return absl::OkStatus();
  }

  absl::StatusOr<Image> Finish() && {
    if (!begun_ || channel_ != image_.channels.size() || partial_bytes_ != 0) {
      return absl::InternalError("the server sent fewer pixels than it promised");
    }
    return std::move(image_);
  }

 private:
  void PutWord(uint32_t word) {
    ImageChannel& channel = image_.channels[channel_];
    if (channel.is_uint) {
      channel.uints.push_back(word);
    } else {
      channel.floats.push_back(std::bit_cast<float>(word));
    }
    const size_t count = channel.is_uint ? channel.uints.size() : channel.floats.size();
    if (static_cast<int64_t>(count) == image_.data_window.area()) ++channel_;
  }

  Image image_;
  bool begun_ = false;
  size_t channel_ = 0;  // the one that is being filled
  char partial_[sizeof(uint32_t)] = {};
  size_t partial_bytes_ = 0;
};

}  // namespace

absl::StatusOr<FetchedImage> FarmClient::GetImage(const std::string& name,
                                                  const ImageRequest& request,
                                                  std::stop_token stop) {
  v1::GetImageRequest wire;
  wire.set_job(name);
  if (!request.region.empty()) {
    wire.mutable_region()->set_x(request.region.x_begin);
    wire.mutable_region()->set_y(request.region.y_begin);
    wire.mutable_region()->set_width(request.region.width());
    wire.mutable_region()->set_height(request.region.height());
  }
  for (const std::string& layer : request.layers) wire.add_layers(layer);
  wire.set_wait_for_filter(request.wait_for_filter);

  FetchedImage fetched;
  absl::Status malformed;
  const auto fetch = [&](grpc::ClientContext* context, bool*) {
    ImageAssembler assembler;
    const std::unique_ptr<grpc::ClientReaderInterface<v1::GetImageResponse>> stream =
        images_->GetImage(context, wire);
    v1::GetImageResponse response;
    while (malformed.ok() && stream->Read(&response)) {
      if (response.has_header()) {
        malformed = assembler.Begin(response.header());
        fetched.spp = response.header().spp();
      }
      if (malformed.ok()) malformed = assembler.Append(response.chunk());
    }
    if (!malformed.ok()) {
      context->TryCancel();
      stream->Finish();
      return grpc::Status(grpc::StatusCode::INTERNAL, "malformed picture");
    }
    const grpc::Status status = stream->Finish();
    if (!status.ok()) return status;
    absl::StatusOr<Image> image = std::move(assembler).Finish();
    if (image.ok()) {
      fetched.image = *std::move(image);
    } else {
      malformed = image.status();
    }
    return status;
  };
  const absl::Status status = caller_.Stream(fetch, stop);
  if (!malformed.ok()) return malformed;
  if (!status.ok()) return status;
  return fetched;
}

}  // namespace tessera
