// tessera.v1.ImageService over pictures and films.
#pragma once

#include "server/coordinator/limits.h"
#include "server/coordinator_host.h"
#include "server/picture/picture_service.h"
#include "server/rpc/client_limits.h"
#include "server/rpc/stream_budget.h"
#include "server/rpc/write_deadlines.h"
#include "server/security/access.h"
#include "tessera/v1/image.grpc.pb.h"

namespace tessera {

class ImageService final : public v1::ImageService::CallbackService {
 public:
  // The film of a job, from memory or disk. Errors: NOT_FOUND, DATA_LOSS.
  using FilmSource = std::function<absl::StatusOr<std::shared_ptr<const Film>>(JobId)>;
  // References must outlive the service.
  ImageService(CoordinatorHost& host, PictureService& pictures, FilmSource film_of,
               const Access& access, ClientLimits& limits, WriteDeadlines& deadlines)
      : host_(host),
        pictures_(pictures),
        film_of_(std::move(film_of)),
        access_(access),
        limits_(limits),
        deadlines_(deadlines) {}

  grpc::ServerWriteReactor<v1::GetImageResponse>* GetImage(
      grpc::CallbackServerContext* context, const v1::GetImageRequest* request) override;
  grpc::ServerWriteReactor<v1::GetFilmResponse>* GetFilm(
      grpc::CallbackServerContext* context, const v1::GetFilmRequest* request) override;

 private:
  // The caller's place among the streams that it may have open.
  absl::StatusOr<ClientLimits::Hold> Enter(grpc::CallbackServerContext* context);

  CoordinatorHost& host_;
  PictureService& pictures_;
  const FilmSource film_of_;
  const Access& access_;
  ClientLimits& limits_;
  WriteDeadlines& deadlines_;
  StreamBudget image_budget_{"pictures", kImageStreamsMax, kImageStreamBytesMax};
  StreamBudget film_budget_{"films", kFilmStreamsMax, kFilmStreamBytesMax};
};

}  // namespace tessera
