// Prefiltered copies of a colour texture, each half as large as the one before, for surfaces that
// show many texels in a pixel. Linear RGB in 16 bits, so that averages do not round to the file's
// 8 bits. Footprints by ray cones: Akenine-Moller et al. 2021, "Improved Shader and Texture Level
// of Detail Using Ray Cones".
#pragma once

#include <Imath/ImathVec.h>

#include <cstdint>
#include <vector>

#include "worker/scene/scene.h"

namespace tessera {

class TextureMips {
 public:
  TextureMips() = default;  // no levels
  // Averages by area, in linear light; with `weighted` by alpha too, so that texels that nobody
  // sees do not colour those beside them. Alpha itself has no levels: every sample of a pixel
  // decides it at full size. Borrows nothing.
  explicit TextureMips(const Texture& texture, bool weighted = false);

  int num_levels() const { return static_cast<int>(levels_.size()); }
  // The level to read where the path's cone is `footprint` texels of the full size wide: its texels
  // are at most half of that, so that the pixel's own samples still decide the picture's
  // sharpness. 0 = the texture itself.
  int LevelFor(float footprint) const;
  // Bilinear, as LookupSrgb; `level` in [1, num_levels()].
  Imath::V3f Lookup(const Texture& texture, const TextureRef& ref, const Imath::V2f& uv,
                    int level) const;
  int64_t memory_bytes() const;

 private:
  struct Level {
    int width, height;
    std::vector<uint16_t> rgb;  // row-major
  };
  // `texel(index, c)`: channel c of texel `index` of the width x height above, as a 16-bit code.
  // `alphas`: of those texels; replaced by the new level's. Empty: all the same.
  template <typename Texel>
  static Level Halve(int width, int height, const Texel& texel, std::vector<float>* alphas);
  // Gives texels that are quite invisible the colour of the level below (pull-push: Gortler et al.
  // 1996, "The Lumigraph"), since reading interpolates.
  void FillInvisible(const std::vector<std::vector<float>>& alphas);

  std::vector<Level> levels_;  // entry 0 is level 1
};

}  // namespace tessera
