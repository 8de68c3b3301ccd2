#include "server/rpc/image_service.h"

#include <algorithm>
#include <bit>
#include <optional>

#include "absl/strings/str_cat.h"
#include "core/film/delta_codec.h"
#include "core/image/layers.h"
#include "server/coordinator/job_settings.h"
#include "server/coordinator/limits.h"
#include "server/rpc/refused_stream.h"
#include "server/rpc/rpc_status.h"

namespace tessera {
namespace {

static_assert(std::endian::native == std::endian::little, "planes travel little-endian");

// What the request asks for; absent: all that the job renders.
std::optional<PixelRect> PartOf(const v1::GetImageRequest& request,
                                const v1::JobSettings& settings) {
  if (!request.has_region()) return std::nullopt;
  const PixelRect region = RectOf(request.region());
  if (region == RegionOf(settings)) return std::nullopt;
  return region;
}

class ImageReactor : public grpc::ServerWriteReactor<v1::GetImageResponse> {
 public:
  ImageReactor(const v1::GetImageRequest& request, StreamBudget* budget, ClientLimits::Hold hold,
               WriteDeadlines* deadlines, grpc::CallbackServerContext* context)
      : request_(request), budget_(budget), hold_(std::move(hold)), deadline_(deadlines, context) {
    if (request_.layers().empty()) request_.add_layers("final");
  }

  void Start(CoordinatorHost& host, PictureService& pictures) {
    if (absl::Status status = budget_->Begin(&share_); !status.ok()) return Finish(ToGrpc(status));
    const absl::StatusOr<JobId> id = ParseJobName(request_.job());
    if (!id.ok()) return Finish(ToGrpc(id.status()));
    if (request_.layers_size() > static_cast<int>(PictureLayers().size())) {
      return Finish(ToGrpc(absl::InvalidArgumentError("layers: each may be named once")));
    }
    const absl::StatusOr<v1::Job> job =
        host.Read([&](const Coordinator& c) { return c.GetJob(*id); });
    if (!job.ok()) return Finish(ToGrpc(job.status()));
    pictures.Fetch(*id, PartOf(request_, job->settings()), request_.wait_for_filter(),
                   [this, &host, id = *id](const std::shared_ptr<const Picture>& picture) {
                     Send(host, id, picture.get());
                   });
  }

  void OnWriteDone(bool ok) override {
    deadline_.End();
    ok ? WriteNext() : Finish(grpc::Status::CANCELLED);
  }
  void OnDone() override { delete this; }

 private:
  void Send(CoordinatorHost& host, JobId id, const Picture* picture) {
    const absl::StatusOr<v1::Job> job =
        host.Read([&](const Coordinator& c) { return c.GetJob(id); });
    if (!job.ok()) return Finish(ToGrpc(job.status()));
    if (picture == nullptr) {
      return Finish(ToGrpc(absl::UnavailableError(absl::StrCat(
          "no picture of ", job->name(), ": the server is stopping (try again later), or the job's "
          "film on its disk is damaged (see its log)"))));
    }
    const PixelRect region =
        request_.has_region() ? RectOf(request_.region()) : RegionOf(job->settings());
    int64_t channels = 0;
    for (const std::string& name : request_.layers()) {
      const PictureLayer* const layer = FindPictureLayer(name);
      channels += layer == nullptr ? 0 : std::ssize(layer->channels);
    }
    const PixelRect pixels = region.Intersect(picture->region());
    const int64_t bytes =
        pixels.empty() ? 0 : pixels.area() * channels * int64_t{sizeof(float)};
    if (absl::Status status = budget_->Take(bytes, &share_); !status.ok()) {
      return Finish(ToGrpc(status));
    }
    absl::StatusOr<Image> image =
        picture->Snapshot(region, {request_.layers().begin(), request_.layers().end()});
    if (!image.ok()) return Finish(ToGrpc(image.status()));
    image_ = *std::move(image);

    v1::ImageHeader& header = *response_.mutable_header();
    *header.mutable_region() = RegionProto(region);
    header.set_frame_width(job->settings().width());
    header.set_frame_height(job->settings().height());
    *header.mutable_revision() = job->revision();
    header.set_spp(request_.has_region() ? picture->spp(region) : picture->spp());
    for (const std::string& name : request_.layers()) {
      const PictureLayer* const layer = FindPictureLayer(name);
      v1::ImageLayer& out = *header.add_layers();
      out.set_name(name);
      out.set_is_uint(layer->is_uint);
      for (const std::string_view channel : layer->channels) {
        out.add_channels(std::string(channel));
      }
    }
    Write();
  }

  void WriteNext() {
    response_.Clear();
    while (channel_ < image_.channels.size()) {
      const ImageChannel& channel = image_.channels[channel_];
      const void* const values = channel.is_uint
                                     ? static_cast<const void*>(channel.uints.data())
                                     : static_cast<const void*>(channel.floats.data());
      const auto* const bytes = static_cast<const char*>(values);
      const size_t size = sizeof(float) * static_cast<size_t>(image_.data_window.area());
      if (offset_ < size) {
        const size_t count = std::min<size_t>(kChunkBytesMax, size - offset_);
        response_.set_chunk(bytes + offset_, count);
        offset_ += count;
        return Write();
      }
      ++channel_;
      offset_ = 0;
    }
    Finish(grpc::Status::OK);
  }

  void Write() {
    deadline_.Begin(Now().monotonic_ms);
    StartWrite(&response_);
  }

  v1::GetImageRequest request_;
  StreamBudget* const budget_;
  StreamBudget::Share share_;
  const ClientLimits::Hold hold_;
  WriteDeadlines::Watch deadline_;
  v1::GetImageResponse response_;
  Image image_;
  size_t channel_ = 0;  // of image_, being sent
  size_t offset_ = 0;   // bytes of it that have been sent
};

class FilmReactor : public grpc::ServerWriteReactor<v1::GetFilmResponse> {
 public:
  FilmReactor(CoordinatorHost* host, StreamBudget* budget, ClientLimits::Hold hold,
              WriteDeadlines* deadlines, grpc::CallbackServerContext* context)
      : host_(host), budget_(budget), hold_(std::move(hold)), deadline_(deadlines, context) {}

  void Start(const ImageService::FilmSource& film_of, const std::string& job) {
    const absl::Status status = Open(film_of, job);
    status.ok() ? WriteNext() : Finish(ToGrpc(status));
  }
  void OnWriteDone(bool ok) override {
    deadline_.End();
    ok ? WriteNext() : Finish(grpc::Status::CANCELLED);
  }
  void OnDone() override { delete this; }

 private:
  absl::Status Open(const ImageService::FilmSource& film_of, const std::string& job) {
    const absl::StatusOr<JobId> id = ParseJobName(job);
    if (!id.ok()) return id.status();
    const absl::StatusOr<v1::Job> record =
        host_->Read([&](const Coordinator& c) { return c.GetJob(*id); });
    if (!record.ok()) return record.status();
    // Before it is read from disk.
    const int64_t bytes = RegionOf(record->settings()).area() * kFilmBytesPerPixel;
    if (absl::Status status = budget_->Begin(&share_); !status.ok()) return status;
    if (absl::Status status = budget_->Take(bytes, &share_); !status.ok()) return status;
    absl::StatusOr<std::shared_ptr<const Film>> film = film_of(*id);
    if (!film.ok()) return film.status();
    film_ = *std::move(film);
    return absl::OkStatus();
  }
  void WriteNext() {
    // One tile's nodes at a time: each tile is a consistent set of samples, and so is their union.
    while (node_ == nodes_.size() && tile_ < film_->grid().num_tiles()) {
      nodes_ = host_->Read([&](const Coordinator&) { return film_->Nodes(tile_); });
      node_ = 0;
      ++tile_;
    }
    if (node_ == nodes_.size()) return Finish(grpc::Status::OK);
    const TileStatistics& statistics = nodes_[node_++];
    EncodedDelta delta = EncodeDelta(statistics, DeltaEncoding::kPackedZstd);
    v1::FilmNode& node = *response_.mutable_node();
    *node.mutable_window() = RegionProto(statistics.window());
    node.set_sample_begin(statistics.range().begin);
    node.set_sample_end(statistics.range().end);
    node.set_feature_end(statistics.feature_end());
    node.set_encoding(static_cast<uint32_t>(delta.encoding));
    node.set_payload(std::move(delta.payload));
    node.set_payload_bytes(delta.payload_bytes);
    Write();
  }

  void Write() {
    deadline_.Begin(Now().monotonic_ms);
    StartWrite(&response_);
  }

  CoordinatorHost* const host_;
  StreamBudget* const budget_;
  StreamBudget::Share share_;
  const ClientLimits::Hold hold_;
  WriteDeadlines::Watch deadline_;
  std::shared_ptr<const Film> film_;
  std::vector<TileStatistics> nodes_;  // of tile_ - 1
  size_t node_ = 0;
  int64_t tile_ = 0;
  v1::GetFilmResponse response_;
};

}  // namespace

absl::StatusOr<ClientLimits::Hold> ImageService::Enter(grpc::CallbackServerContext* context) {
  const absl::StatusOr<Caller> caller = access_.Check(*context, Role::kView);
  if (!caller.ok()) return caller.status();
  return limits_.OpenStream(ClientOf(*caller, context->peer()));
}

grpc::ServerWriteReactor<v1::GetImageResponse>* ImageService::GetImage(
    grpc::CallbackServerContext* context, const v1::GetImageRequest* request) {
  using Stream = grpc::ServerWriteReactor<v1::GetImageResponse>;
  absl::StatusOr<ClientLimits::Hold> hold = Enter(context);
  if (!hold.ok()) return new RefusedStream<Stream>(hold.status());
  auto* const reactor =
      new ImageReactor(*request, &image_budget_, *std::move(hold), &deadlines_, context);
  reactor->Start(host_, pictures_);
  return reactor;
}

grpc::ServerWriteReactor<v1::GetFilmResponse>* ImageService::GetFilm(
    grpc::CallbackServerContext* context, const v1::GetFilmRequest* request) {
  using Stream = grpc::ServerWriteReactor<v1::GetFilmResponse>;
  absl::StatusOr<ClientLimits::Hold> hold = Enter(context);
  if (!hold.ok()) return new RefusedStream<Stream>(hold.status());
  auto* const reactor =
      new FilmReactor(&host_, &film_budget_, *std::move(hold), &deadlines_, context);
  reactor->Start(film_of_, request->job());
  return reactor;
}

}  // namespace tessera
