// The isotropic GGX microfacet distribution with Smith's height-correlated masking, in the local
// frame of the surface (z = normal). Walter et al. 2007; Heitz 2014, "Understanding the
// Masking-Shadowing Function"; Dupuy & Benyoub 2023, "Sampling Visible GGX Normals with Spherical
// Caps".
#pragma once

#include <Imath/ImathVec.h>

#include <algorithm>
#include <cmath>

#include "worker/integrator/ablation.h"
#include "worker/integrator/float8_math.h"
#include "worker/integrator/portable_math.h"

namespace tessera {

// Smaller widths than this are not told apart in float; 0.02 degrees.
inline constexpr float kAlphaMin = 2e-4f;

inline float AlphaOfRoughness(float roughness) {
  return std::max(roughness * roughness, kAlphaMin);
}

// Density of normals, 1/sr. Written without the difference 1 - z^2, which cancels for small alpha.
inline float GgxD(const Imath::V3f& h, float alpha) {
  const float a2 = alpha * alpha;
  const float t = (h.x * h.x + h.y * h.y) / a2 + h.z * h.z;
  return 1 / (kPiFloat * a2 * t * t);
}

// Smith's Lambda.
inline float GgxLambda(const Imath::V3f& w, float alpha) {
  const float z2 = w.z * w.z;
  if (!(z2 > 0)) return 1e18f;
  const float tan2 = (w.x * w.x + w.y * w.y) / z2;
  return 0.5f * (std::sqrt(1 + alpha * alpha * tan2) - 1);
}

// The two for eight lanes.
inline Float8 GgxD(const Vec8& h, Float8 alpha) {
  const Float8 a2 = alpha * alpha;
  const Float8 t = (h.x * h.x + h.y * h.y) / a2 + h.z * h.z;
  return 1 / (kPiFloat * a2 * t * t);
}
inline Float8 GgxLambda(const Vec8& w, Float8 alpha) {
  const Float8 z2 = w.z * w.z;
  const Float8 tan2 = (w.x * w.x + w.y * w.y) / z2;
  const Float8 lambda = 0.5f * (Sqrt8(1 + alpha * alpha * tan2) - 1);
  return z2 > 0 ? lambda : Spread8(1e18f);
}

// A microfacet normal with density G1(wo) max(0, wo.h) D(h) / wo.z; wo.z > 0.
inline Imath::V3f SampleGgxVisibleNormal(const Imath::V3f& wo, float alpha, const Imath::V2f& u) {
  const Imath::V3f o = Unit({wo.x * alpha, wo.y * alpha, wo.z});
  const SinCos<float> phi = SinCosTurns(u.x);
  const float z = (1 - u.y) * (1 + o.z) - o.z;
  const float r = std::sqrt(Clamp01(1 - z * z));
  const Imath::V3f h(r * phi.cos + o.x, r * phi.sin + o.y, z + o.z);
  return Unit({h.x * alpha, h.y * alpha, std::max(h.z, 1e-12f)});
}

// The same in eight lanes, given `phi`, SinCosTurns(u.x).
inline Vec8 SampleGgxVisibleNormal(const Vec8& wo, Float8 alpha, const SinCos8& phi, Float8 u_y) {
  const Vec8 o = Unit8({wo.x * alpha, wo.y * alpha, wo.z});
  const Float8 z = (1 - u_y) * (1 + o.z) - o.z;
  const Float8 r = Sqrt8(Clamp01(1 - z * z));
  const Vec8 h = {r * phi.cos + o.x, r * phi.sin + o.y, z + o.z};
  return Unit8({h.x * alpha, h.y * alpha, Max8(h.z, Spread8(1e-12f))});
}

// The normals that a surface is sampled by, and the factor that makes their density of
// D(h) / wo.z max(0, wo.h): Steps() may leave visibility out (Walter et al. 2007, eq. 35-36). Of
// both, Real and Vec are for one number or for eight.
inline Imath::V3f SampleGgxNormal(const Imath::V3f& wo, float alpha, const Imath::V2f& u) {
  if (Steps().visible_normals) return SampleGgxVisibleNormal(wo, alpha, u);
  const SinCos<float> phi = SinCosTurns(u.x);
  const float r = alpha * std::sqrt(u.y / (1 - u.y));
  return Unit({r * phi.cos, r * phi.sin, 1});
}

inline Vec8 SampleGgxNormal(const Vec8& wo, Float8 alpha, const SinCos8& phi, Float8 u_y) {
  if (Steps().visible_normals) return SampleGgxVisibleNormal(wo, alpha, phi, u_y);
  const Float8 r = alpha * Sqrt8(u_y / (1 - u_y));
  return Unit8({r * phi.cos, r * phi.sin, Spread8(1)});
}

template <typename Real, typename Vec>
Real GgxNormalPdf(Real density, const Vec& h, const Vec& wo, Real o_h, Real lambda_o) {
  if (Steps().visible_normals) return density / (1 + lambda_o);
  return density * h.z * wo.z / (o_h + 1e-12f);
}

// Schlick 1994: the weight (1 - cos)^5 of F90.
inline float SchlickWeight(float cosine) {
  const float m = Clamp01(1 - cosine);
  return Sqr(m * m) * m;
}

inline Float8 SchlickWeight(Float8 cosine) {
  const Float8 m = Clamp01(1 - cosine);
  return m * m * (m * m) * m;
}

// Fresnel reflectance of a smooth dielectric; eta = index on the transmitted side over the incident
// side; cos_i in [0, 1]. Writes the transmitted cosine, 0 under total reflection.
inline float FresnelDielectric(float cos_i, float eta, float* cos_t) {
  const float sin2_t = (1 - cos_i * cos_i) / (eta * eta);
  if (sin2_t >= 1) {
    *cos_t = 0;
    return 1;
  }
  *cos_t = std::sqrt(1 - sin2_t);
  const float parallel = (eta * cos_i - *cos_t) / (eta * cos_i + *cos_t);
  const float perpendicular = (cos_i - eta * *cos_t) / (cos_i + eta * *cos_t);
  return 0.5f * (parallel * parallel + perpendicular * perpendicular);
}

}  // namespace tessera
