// FarmClient::GetFilm: the nodes of the folding tree that a job's tiles consist of.
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/farm_client.h"
#include "core/film/delta_codec.h"

namespace tessera {

absl::StatusOr<std::vector<TileStatistics>> FarmClient::GetFilm(const std::string& name,
                                                                std::stop_token stop) {
  v1::GetFilmRequest request;
  request.set_job(name);
  std::vector<TileStatistics> nodes;
  absl::Status malformed;
  const auto fetch = [&](grpc::ClientContext* context, bool*) {
    nodes.clear();
    const std::unique_ptr<grpc::ClientReaderInterface<v1::GetFilmResponse>> stream =
        images_->GetFilm(context, request);
    v1::GetFilmResponse response;
    while (malformed.ok() && stream->Read(&response)) {
      const v1::FilmNode& node = response.node();
      const v1::Region& window = node.window();
      absl::StatusOr<TileStatistics> tile =
          DecodeDelta(PixelRect::FromSize(window.x(), window.y(), window.width(), window.height()),
                      {node.sample_begin(), node.sample_end()}, node.feature_end(), node.encoding(),
                      node.payload());
      if (tile.ok()) {
        nodes.push_back(*std::move(tile));
      } else {
        malformed = absl::InternalError(
            absl::StrCat("the server sent a damaged film: ", tile.status().message()));
        context->TryCancel();
      }
    }
    return stream->Finish();
  };
  const absl::Status status = caller_.Stream(fetch, stop);
  if (!malformed.ok()) return malformed;
  if (!status.ok()) return status;
  if (nodes.empty()) {
    return absl::FailedPreconditionError(
        absl::StrCat(name, " has no samples yet: wait until workers have delivered some"));
  }
  return nodes;
}

}  // namespace tessera
