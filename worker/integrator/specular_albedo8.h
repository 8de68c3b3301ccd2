// SpecularAlbedoTable's answers for eight surfaces at once; a lane has the bits of AtRoughness.
#pragma once

#include <array>

#include "worker/integrator/ablation.h"
#include "worker/integrator/float8_math.h"
#include "worker/integrator/specular_albedo.h"

namespace tessera {

class SpecularAlbedo8 {
 public:
  // SpecularAlbedo, lane by lane.
  struct Albedo {
    Float8 scale, bias;
    Float8 MultipleScattering() const { return CompensationOf8(scale + bias) - 1; }
  };
  struct Average {
    Albedo single, multiple;
  };

  // All lanes are to be set.
  void Set(int lane, float roughness) {
    const SpecularAlbedoTable::AtRoughness at = SpecularAlbedoTable::Get().At(roughness);
    lower_[lane] = at.lower_;
    upper_[lane] = at.upper_;
    weight_[lane] = at.weight_;
    alpha_[lane] = at.alpha_;
  }
  const Float8& alpha() const { return alpha_; }

  Albedo Lookup(Float8 mu) const {
    constexpr int kCells = SpecularAlbedoTable::kColumns;
    const Float8 position = AlbedoNode8(mu) * static_cast<float>(kCells - 1);
    const Int8 truncated = Truncate8(position), last = Int8{} + (kCells - 2);
    const Int8 cell = truncated < last ? truncated : last;
    const Float8 t = position - Float8Of(cell);
    const auto lookup = [&](const RowPointers& rows) {
      std::array<const float*, kFloat8Lanes> from;
      for (int i = 0; i < kFloat8Lanes; ++i) from[i] = &rows[i]->cells[cell[i]].scale;
      const FourOf8 pair = LoadFour8(from);
      return Albedo{pair[0] + (pair[2] - pair[0]) * t, pair[1] + (pair[3] - pair[1]) * t};
    };
    return Between(lookup(lower_), lookup(upper_));
  }
  Average CosineAverage() const {
    const auto lookup = [](const RowPointers& rows) {
      std::array<const float*, kFloat8Lanes> from;
      for (int i = 0; i < kFloat8Lanes; ++i) from[i] = &rows[i]->average.single.scale;
      const FourOf8 four = LoadFour8(from);
      return Average{{four[0], four[1]}, {four[2], four[3]}};
    };
    const Average lower = lookup(lower_), upper = lookup(upper_);
    return {Between(lower.single, upper.single), Between(lower.multiple, upper.multiple)};
  }

 private:
  using RowPointers = std::array<const SpecularAlbedoTable::Row*, kFloat8Lanes>;

  static Float8 CompensationOf8(Float8 albedo) {
    if (!Steps().energy_compensation) return Spread8(1);
    const Float8 missing = 1 / Max8(albedo, Spread8(1e-3f)) - 1;
    return 1 + Max8(missing * (1 - kCompensationMarginShare) - kCompensationMarginNoise, Float8{});
  }
  Float8 AlbedoNode8(Float8 mu) const {
    const Float8 a = 2 * alpha_, cosine = Clamp01(mu);
    return 0.5f * (Sqrt8(cosine) + Sqrt8(cosine * (1 + a) / (cosine + a)));
  }
  Albedo Between(const Albedo& a, const Albedo& b) const {
    return {a.scale + (b.scale - a.scale) * weight_, a.bias + (b.bias - a.bias) * weight_};
  }

  RowPointers lower_, upper_;
  Float8 weight_, alpha_;
};

}  // namespace tessera
