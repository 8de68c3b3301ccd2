// Reads of 8-bit textures: wrap, bilinear filter, sRGB decoding, KHR_texture_transform.
#pragma once

#include <Imath/ImathVec.h>

#include "worker/scene/scene.h"

namespace tessera {

// Linear value of an 8-bit sRGB code (IEC 61966-2-1).
float LinearOfSrgb(uint8_t code);

// The four texels around `uv` in a grid of width x height that stands for the texture.
struct BilinearTexels {
  int x0, x1, y0, y1;
  float fx, fy;  // weights of x1 and y1
};
BilinearTexels BilinearAt(int width, int height, const Texture& texture, const TextureRef& ref,
                          const V2f& uv);

// The texture's value at `uv` of the reference's uv set, in [0, 1]; alpha is never decoded.
// (u, v) = (0, 0) is the outer corner of the top left texel. Non-finite uv read as 0.
V4f LookupSrgb(const Texture& texture, const TextureRef& ref, const V2f& uv);
V4f LookupLinear(const Texture& texture, const TextureRef& ref, const V2f& uv);

}  // namespace tessera
