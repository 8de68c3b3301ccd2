// tessera compare PICTURE REFERENCE [REFERENCE2]: the error measures of docs and charts.
#include "core/image/compare.h"

#include <cmath>
#include <cstdio>

#include <nlohmann/json.hpp>

#include "client/cli/commands.h"
#include "client/cli/job_command.h"
#include "core/image/image_reader.h"

namespace tessera {

absl::Status RunCompare(const CompareFlags& flags) {
  std::vector<std::string> paths = {flags.image};
  paths.insert(paths.end(), flags.references.begin(), flags.references.end());
  std::vector<Image> images;
  for (const std::string& path : paths) {
    absl::StatusOr<Image> image = ReadImage(path);
    if (!image.ok()) return image.status();
    images.push_back(*std::move(image));
  }
  NamedImage second;
  if (images.size() > 2) second = {paths[2], &images[2]};
  const absl::StatusOr<ImageErrors> errors =
      CompareImages({paths[0], &images[0]}, {paths[1], &images[1]}, second);
  if (!errors.ok()) return errors.status();
  // Two noisy references can make the estimate slightly negative: no error can be seen.
  const double rel_rmse = std::sqrt(std::fmax(0.0, errors->rel_mse));
  if (flags.json) {
    PrintJson({{"rel_mse", errors->rel_mse},
               {"rel_mse_trimmed", errors->rel_mse_trimmed},
               {"rel_rmse", rel_rmse},
               {"psnr_db", errors->psnr_db},
               {"ssim", errors->ssim},
               {"flip", errors->flip}});
    return absl::OkStatus();
  }
  std::printf("relMSE          %.6g\n", errors->rel_mse);
  std::printf("relMSE trimmed  %.6g\n", errors->rel_mse_trimmed);
  std::printf("relative RMSE   %.6g\n", rel_rmse);
  std::printf("PSNR            %.4g dB\n", errors->psnr_db);
  std::printf("SSIM            %.6g\n", errors->ssim);
  std::printf("FLIP            %.6g\n", errors->flip);
  return absl::OkStatus();
}

}  // namespace tessera
