// Rays from the scene's camera through points of the frame: perspective and orthographic, with a
// thin lens.
#pragma once

#include <Imath/ImathVec.h>

#include "worker/integrator/float8_math.h"
#include "worker/scene/scene.h"

namespace tessera {

struct CameraRay {
  V3f origin;
  V3f direction;  // unit
};

// The unit disc, area-preserving. Shirley & Chiu 1997, "A Low Distortion Map Between Disk and
// Square".
V2f UnitDiscOfSquare(const V2f& u);

class CameraRays {
 public:
  // Square pixels; the vertical field of view spans the frame's height.
  CameraRays(const SceneCamera& camera, int width, int height);

  // `x`, `y`: in pixels from the frame's top left corner. `lens` in [0, 1)^2.
  CameraRay At(float x, float y, const V2f& lens) const;
  // A pixel's width at distance t: width + spread * t, metres.
  struct PixelCone {
    float width, spread;
  };
  PixelCone pixel_cone() const {
    return orthographic_ ? PixelCone{scale_, 0} : PixelCone{0, scale_};
  }
  // One position; a direction for each place in the picture.
  bool is_pinhole() const { return !orthographic_ && !has_lens(); }
  const V3f& position() const { return position_; }
  // Of a pinhole: At's directions of eight places at once, with the same bits.
  Vec8 PinholeDirections(Float8 x, Float8 y) const;
  bool has_lens() const { return lens_radius_ > 0; }

 private:
  bool orthographic_;
  V3f position_, right_, up_, forward_;
  float half_width_px_, half_height_px_;
  float scale_;  // tangent of half the field of view, or half the height in metres, over
                 // half_height_px
  float lens_radius_, focus_distance_;
};

}  // namespace tessera
