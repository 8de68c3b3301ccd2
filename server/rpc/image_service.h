// tessera.v1.ImageService over pictures and films.
#pragma once

#include "server/coordinator_host.h"
#include "server/picture/picture_service.h"
#include "tessera/v1/image.grpc.pb.h"

namespace tessera {

class ImageService final : public v1::ImageService::CallbackService {
 public:
  // Both must outlive the service.
  ImageService(CoordinatorHost& host, PictureService& pictures)
      : host_(host), pictures_(pictures) {}

  grpc::ServerWriteReactor<v1::GetImageResponse>* GetImage(
      grpc::CallbackServerContext* context, const v1::GetImageRequest* request) override;
  grpc::ServerWriteReactor<v1::GetFilmResponse>* GetFilm(
      grpc::CallbackServerContext* context, const v1::GetFilmRequest* request) override;

 private:
  CoordinatorHost& host_;
  PictureService& pictures_;
};

}  // namespace tessera
