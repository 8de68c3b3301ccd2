// Every constant of the regression filter that is not a rounding error, and how far its stages
// read. What each is worth: bench/denoiser_bench --sensitivity, docs/denoiser.md.
#pragma once

#include <algorithm>

#include "core/denoise/regression_input.h"

namespace tessera {

// Of the weights of a pass.
struct WeightSettings {
  // How much noisier than the centre a neighbour may be to be excused by its own noise (in
  // variance), where a pixel's variance is its own: in the first pass. A firefly differs from its
  // neighbours by no more than its own noise, and would lend to them all. Measured.
  float excuse_ratio = 4.0f;
  // Above this ratio to the centre's variance, a neighbour's is larger: by how much two estimates
  // of one variance differ in one case of twenty, from four samples each, the fewest that are worth
  // filtering. The logarithm of a normal variable's sample variance has a variance of about
  // 2 / (n - 1) (Bartlett & Kendall 1946), so exp(1.96 * 2 / sqrt(3)).
  float lent_ratio = 9.6f;
  // exp(-x) is taken as (1 - x / 2^n)^(2^n), which ends at 2^n: weights below e^-8 change nothing.
  int falloff_squarings = 3;
};

struct RegressionSettings {
  // Supports: larger ones cost more.
  int window_radius_px = 9;
  int prefilter_radius_px = 2;
  int lattice_step_px = 5;
  // What a pixel predicts that its neighbours' fits leave out, and the weight below which they do:
  // a little less than one pixel's own, which saves time.
  int on_demand_reach_px = 3;
  float thin_weight = 0.8f;
  // The second pass compares patches in units of the pilot's variance, averaged over so many pixels
  // around, plus this share of the raw mean's, which stands for the pilot's bias. Measured.
  int pilot_radius_px = 1;
  float raw_share = 0.2f;
  // The blend's risks are pooled over (2 r + 1)^2 pixels; so is the picture's error, more widely,
  // as it is pooled relative to the noise.
  int risk_radius_px = 6;
  int error_radius_px = 9;
  // How much noisier than the mean of the pixels around it a pixel must be to be taken for an
  // outlier (OutlierReader): an estimate from four samples, the fewest that are worth filtering,
  // exceeds the truth by this factor in one case of a thousand, exp(3.09 sqrt(2 / 3)): as
  // WeightSettings::lent_ratio, but against a mean that is known, and of a pixel that is changed.
  float outlier_ratio = 12.5f;
  // Of the probe, in standard deviations: small against the noise, that the filter's response is
  // about linear, and large against rounding. The estimate does not depend on it where the filter
  // is differentiable.
  float probe_step = 0.1f;
  WeightSettings weights;

  // Pixels around what a pass makes whose data it reads: windows, predicted windows, and two rounds
  // of predictions on demand.
  int pass_reach_px() const { return 2 * window_radius_px + 2 * on_demand_reach_px; }
  // Around what the second pass makes, of the first one's result: patches, and the variance.
  int first_of_second_px() const { return pass_reach_px() + 1 + pilot_radius_px; }
  // Around the picture, of the passes' results: pooled to be blended and pooled to be judged.
  int picture_reach_px() const { return risk_radius_px + error_radius_px; }
  // How far around news in the planes features change, and the fits' centres of the first pass; a
  // patch has a radius of one.
  int feature_news_px() const { return prefilter_radius_px + 1; }
  int first_centre_news_px() const {
    return window_radius_px + std::max(1 + kInputRadiusPx, feature_news_px());
  }
  // How far around news in the first pass centres of the second one change, and around news in the
  // planes if the first pass stays the same.
  int second_centre_news_px() const { return window_radius_px + 1 + pilot_radius_px; }
  int second_centre_plane_news_px() const {
    return std::max(second_centre_news_px() + kInputRadiusPx,
                    window_radius_px + feature_news_px());
  }
  // How far around pixels that become centres, or are none any more, a pass changes: these predict,
  // and others may become centres in the second round.
  int on_demand_news_px() const { return 2 * on_demand_reach_px; }
  // How far around news in the planes each pass may change.
  int first_news_px() const {
    return first_centre_news_px() + window_radius_px + on_demand_news_px();
  }
  int second_news_px() const { return first_of_second_px() + first_news_px(); }
  int reach_px() const { return picture_reach_px() + second_news_px(); }
};

}  // namespace tessera
