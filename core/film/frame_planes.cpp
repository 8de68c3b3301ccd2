#include "core/film/frame_planes.h"

#include <limits>

#include "core/base/check.h"
#include "core/film/fold.h"

namespace tessera {
namespace {

constexpr float kUnknown = std::numeric_limits<float>::infinity();

void Allocate(size_t area, Planes3* planes) {
  for (Plane& plane : *planes) plane.assign(area, 0.0f);
}

// The mean of both halves and the sample variance of that mean; +inf for fewer than two samples.
void JoinHalves(const TileStatistics& tile, int mean_plane, int msd_plane, size_t pixel,
                int32_t count_a, int32_t count_b, float* mean, float* variance_of_mean) {
  float msd;
  FoldMoments(tile.Floats(0, mean_plane)[pixel], tile.Floats(0, msd_plane)[pixel],
              tile.Floats(1, mean_plane)[pixel], tile.Floats(1, msd_plane)[pixel],
              RightWeight(count_a, count_b), mean, &msd);
  const int32_t count = count_a + count_b;
  *variance_of_mean = count < 2 ? kUnknown : msd / static_cast<float>(count - 1);
}

}  // namespace

FramePlanes::FramePlanes(const PixelRect& bounds_in) : bounds(bounds_in) {
  const size_t area = static_cast<size_t>(bounds.area());
  for (Planes3* planes : {&color, &color_half[0], &color_half[1], &sample_variance_of_mean,
                          &variance, &albedo, &albedo_variance, &normal, &normal_variance}) {
    Allocate(area, planes);
  }
  for (Plane* plane : {&depth, &depth_variance, &coverage}) plane->assign(area, 0.0f);
  material_id.assign(area, 0);
  samples.assign(area, 0);
}

void FramePlanes::Resolve(const TileStatistics& tile) {
  const PixelRect& window = tile.window();
  TESSERA_CHECK(bounds.Contains(window));
  TESSERA_CHECK(tile.range().begin == 0 && tile.range().end <= kSamplesMax);
  const int32_t count_a = static_cast<int32_t>(tile.HalfCount(0));
  const int32_t count_b = static_cast<int32_t>(tile.HalfCount(1));
  const int32_t count = count_a + count_b;
  const int32_t feature_count_a = static_cast<int32_t>(tile.FeatureHalfCount(0));
  const int32_t feature_count_b = static_cast<int32_t>(tile.FeatureHalfCount(1));
  size_t from = 0;
  for (int y = window.y_begin; y < window.y_end; ++y) {
    size_t to = static_cast<size_t>(bounds.IndexOf(window.x_begin, y));
    for (int x = window.x_begin; x < window.x_end; ++x, ++from, ++to) {
      for (int c = 0; c < 3; ++c) {
        JoinHalves(tile, kRadianceMean + c, kRadianceMsd + c, from, count_a, count_b, &color[c][to],
                   &sample_variance_of_mean[c][to]);
        JoinHalves(tile, kAlbedoMean + c, kAlbedoMsd + c, from, feature_count_a, feature_count_b,
                   &albedo[c][to], &albedo_variance[c][to]);
        JoinHalves(tile, kNormalMean + c, kNormalMsd + c, from, feature_count_a, feature_count_b,
                   &normal[c][to], &normal_variance[c][to]);
        color_half[0][c][to] = tile.Floats(0, kRadianceMean + c)[from];
        color_half[1][c][to] = tile.Floats(1, kRadianceMean + c)[from];
      }
      const int32_t hits_a = static_cast<int32_t>(tile.Counts(0, kHits)[from]);
      const int32_t hits_b = static_cast<int32_t>(tile.Counts(1, kHits)[from]);
      JoinHalves(tile, kDepthMean, kDepthMsd, from, hits_a, hits_b, &depth[to],
                 &depth_variance[to]);
      const int32_t later_hits =
          static_cast<int32_t>(tile.Counts(0, kLaterHits)[from] + tile.Counts(1, kLaterHits)[from]);
      coverage[to] = static_cast<float>(hits_a + hits_b + later_hits) /
                     static_cast<float>(count > 0 ? count : 1);
      const IdVote vote_a{tile.Counts(0, kMaterialId)[from], tile.Counts(0, kIdVotes)[from]};
      const IdVote vote_b{tile.Counts(1, kMaterialId)[from], tile.Counts(1, kIdVotes)[from]};
      material_id[to] = feature_count_b == 0 ? vote_a.id : FoldVotes(vote_a, vote_b).id;
      samples[to] = static_cast<uint32_t>(count);
    }
  }
}

}  // namespace tessera
