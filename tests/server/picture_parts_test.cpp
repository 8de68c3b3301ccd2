// Who looks at a part of a picture gets the bits of the whole's, and has that part alone filtered.
#include <gtest/gtest.h>

#include <cstring>
#include <functional>
#include <future>
#include <mutex>
#include <numeric>
#include <set>
#include <thread>
#include <utility>

#include "core/image/layers.h"
#include "server/coordinator/job_settings.h"
#include "server/picture/picture_service.h"
#include "tests/server/simulated_farm.h"

namespace tessera {
namespace {

const PixelRect kPart = PixelRect::FromSize(70, 21, 30, 17);

v1::JobSettings Settings(const std::string& denoiser) {
  v1::JobSettings settings = SmallSettings();
  settings.set_width(220);
  settings.set_height(60);
  settings.set_tile_size(8);
  settings.set_denoiser(denoiser);
  return settings;
}

std::vector<int64_t> AllTiles(const TileGrid& grid) {
  std::vector<int64_t> tiles(static_cast<size_t>(grid.num_tiles()));
  std::iota(tiles.begin(), tiles.end(), 0);
  return tiles;
}

// Every third tile, the others later.
std::vector<int64_t> SomeTiles(const TileGrid& grid, int64_t which) {
  std::vector<int64_t> tiles = AllTiles(grid);
  std::erase_if(tiles, [which](int64_t tile) { return tile % 3 != which; });
  return tiles;
}

Picture::TileSource From(const Film& film) {
  return [&film](int64_t tile) { return film.Fold(tile); };
}

::testing::AssertionResult SameBits(const Picture& a, const Picture& b, const PixelRect& region) {
  for (const PictureLayer& layer : PictureLayers()) {
    const Image x = *a.Snapshot(region, {std::string(layer.name)});
    const Image y = *b.Snapshot(region, {std::string(layer.name)});
    for (size_t c = 0; c < x.channels.size(); ++c) {
      const std::vector<float>&u = x.channels[c].floats, &v = y.channels[c].floats;
      if (x.channels[c].uints != y.channels[c].uints || u.size() != v.size() ||
          (!u.empty() && std::memcmp(u.data(), v.data(), sizeof(float) * u.size()) != 0)) {
        return ::testing::AssertionFailure() << layer.name << " differs";
      }
    }
  }
  return ::testing::AssertionSuccess();
}

Views ViewsOf(const PixelRect& region) {
  Views views;
  views.Add(region);
  return views;
}

std::vector<int64_t> Reaching(const Picture& picture, const std::vector<int64_t>& tiles,
                              const Views& views, DenoiseQuality quality) {
  std::vector<int64_t> reaching;
  for (const int64_t tile : tiles) {
    if (picture.Reaches(tile, views, quality)) reaching.push_back(tile);
  }
  return reaching;
}

// Samples come in three steps; after each the part is looked at, taking only what reaches it. What
// was passed over is taken at the end, for the whole.
TEST(PictureParts, HaveTheBitsOfTheWhole) {
  for (const std::string& denoiser : DenoiserNames()) {
    for (const DenoiseQuality quality : {DenoiseQuality::kPreview, DenoiseQuality::kFinal}) {
      SCOPED_TRACE(denoiser + (quality == DenoiseQuality::kFinal ? " final" : " preview"));
      const v1::JobSettings settings = Settings(denoiser);
      const TileGrid grid(RegionOf(settings), settings.tile_size());
      const Film two = SyntheticFilm(1, grid, 2), eight = SyntheticFilm(1, grid, 8);
      Picture part(settings), whole(settings);
      const Views views = ViewsOf(kPart);
      std::vector<int64_t> passed_over;
      const auto step = [&](const std::vector<int64_t>& changed, const Film& film) {
        const std::vector<int64_t> reaching = Reaching(part, changed, views, quality);
        EXPECT_LT(reaching.size(), changed.size());
        part.Update(reaching, From(film), quality, 2, views);
        whole.Update(changed, From(film), quality, 1);
        EXPECT_TRUE(SameBits(part, whole, kPart));
        EXPECT_TRUE(part.HasShown(kPart));
        EXPECT_FALSE(part.HasShown(std::nullopt));
        EXPECT_EQ(part.spp(kPart), whole.spp(kPart));
        EXPECT_EQ(part.IsRefined(views), quality == DenoiseQuality::kFinal);
      };
      step(AllTiles(grid), two);
      step(SomeTiles(grid, 0), eight);
      step(SomeTiles(grid, 1), eight);
      step(SomeTiles(grid, 2), eight);
      part.Update(AllTiles(grid), From(eight), quality, 2);
      EXPECT_TRUE(SameBits(part, whole, grid.region()));
      EXPECT_TRUE(part.HasShown(std::nullopt));
      EXPECT_EQ(part.estimated_error(), whole.estimated_error());
    }
  }
}

// The part first, then the rest: the same bits, and the part is ready before the rest.
TEST(PictureParts, ThatAreWaitedForComeFirst) {
  const v1::JobSettings settings = Settings("regression");
  const TileGrid grid(RegionOf(settings), settings.tile_size());
  const Film eight = SyntheticFilm(1, grid, 8);
  Picture part(settings), whole(settings);
  whole.Update(AllTiles(grid), From(eight), DenoiseQuality::kFinal, 1);
  part.Absorb(AllTiles(grid), From(eight), 2);
  const Views views = ViewsOf(kPart);
  EXPECT_FALSE(part.IsRefined(views));
  part.Refine(40 * 32, 2, nullptr, Views::Whole(), views);
  EXPECT_TRUE(part.IsRefined(views));
  EXPECT_FALSE(part.is_refined());
  EXPECT_TRUE(SameBits(part, whole, kPart));
  while (!part.is_refined()) part.Refine(1000, 2);
  EXPECT_TRUE(SameBits(part, whole, grid.region()));
}

// A job with a film that the test sets; counts the tiles that are folded.
class PartService : public ::testing::Test {
 protected:
  PartService() {
    PictureSource source;
    source.view = [this](JobId) {
      std::lock_guard lock(mu_);
      return std::make_unique<PictureSource::JobView>(
          PictureSource::JobView{settings_, film_->samples(), is_sampling_, film_, true});
    };
    source.fold_tile = [this](const Film& film, int64_t tile) {
      std::lock_guard lock(mu_);
      folded_.insert(tile);
      return film.Fold(tile);
    };
    source.on_picture = [this](const PictureEvent& event) {
      std::lock_guard lock(mu_);
      if (event.is_refined && !std::exchange(is_evaluated_, true)) evaluated_.set_value();
    };
    source.on_finished = [](const JobFinishedEvent&) {};
    service_ = std::make_unique<PictureService>(std::move(source), 2);
  }
  ~PartService() override { service_->Stop(); }

  std::shared_ptr<const Picture> Fetch(const PictureService::Region& region, bool wait) {
    std::promise<std::shared_ptr<const Picture>> promise;
    service_->Fetch(1, region, wait, [&](auto picture) { promise.set_value(picture); });
    return promise.get_future().get();
  }
  void Grow(std::shared_ptr<const Film> film, const std::vector<int64_t>& tiles) {
    {
      std::lock_guard lock(mu_);
      film_ = std::move(film);
      folded_.clear();
    }
    for (const int64_t tile : tiles) service_->TileChanged(1, tile);
  }
  std::shared_ptr<const Film> FilmOf(int64_t spp) const {
    return std::make_shared<const Film>(SyntheticFilm(1, grid_, spp));
  }
  size_t num_folded() {
    std::lock_guard lock(mu_);
    return folded_.size();
  }

  const v1::JobSettings settings_ = Settings("regression");
  const TileGrid grid_{RegionOf(settings_), settings_.tile_size()};
  std::mutex mu_;  // guards the next four
  std::shared_ptr<const Film> film_ = FilmOf(2);
  bool is_sampling_ = true;
  std::set<int64_t> folded_;
  bool is_evaluated_ = false;
  std::promise<void> evaluated_;
  std::unique_ptr<PictureService> service_;
};

TEST_F(PartService, AFetchOfAPartFiltersThatAlone) {
  const PixelRect corner = PixelRect::FromSize(0, 0, 10, 10);
  const auto preview = Fetch(corner, false);
  EXPECT_LT(num_folded(), 60u) << "of " << grid_.num_tiles();
  EXPECT_TRUE(preview->HasShown(corner));
  EXPECT_FALSE(preview->HasShown(std::nullopt));
  EXPECT_EQ(preview->spp(corner), 2);
  const auto waited = Fetch(corner, true);
  EXPECT_FALSE(waited->is_refined());
  EXPECT_LT(num_folded(), static_cast<size_t>(grid_.num_tiles()));
  Picture whole(settings_);
  whole.Update(AllTiles(grid_), From(*FilmOf(2)), DenoiseQuality::kFinal, 1);
  EXPECT_TRUE(SameBits(*waited, whole, corner));
  // More samples everywhere, seen through another part.
  Grow(FilmOf(8), AllTiles(grid_));
  const auto newer = Fetch(kPart, true);
  Picture fresh(settings_);
  fresh.Update(AllTiles(grid_), From(*FilmOf(8)), DenoiseQuality::kFinal, 1);
  EXPECT_TRUE(SameBits(*newer, fresh, kPart));
  EXPECT_EQ(newer->spp(kPart), 8);
  EXPECT_EQ(newer->spp(PixelRect::FromSize(210, 50, 10, 10)), 0) << "nobody has looked there";
  // And the whole, for the coordinator.
  service_->Evaluate(1);
  ASSERT_EQ(evaluated_.get_future().wait_for(std::chrono::seconds(60)),
            std::future_status::ready);
  EXPECT_TRUE(SameBits(*newer, fresh, grid_.region()));
  EXPECT_EQ(newer->estimated_error(), fresh.estimated_error());
}

TEST_F(PartService, AWatcherOfAPartSeesItChange) {
  const PixelRect corner = PixelRect::FromSize(0, 0, 10, 10);
  service_->AddWatcher(1, PixelRect());  // progress alone
  service_->AddWatcher(1, corner);
  Fetch(corner, false);
  // Its rounds bring the part up to date, and nothing else.
  Grow(FilmOf(8), AllTiles(grid_));
  std::shared_ptr<const Picture> seen;
  do {
    seen = Fetch(corner, false);
    std::this_thread::yield();
  } while (seen->spp(corner) < 8);
  EXPECT_LT(num_folded(), 60u);
  EXPECT_FALSE(seen->HasShown(std::nullopt));
  service_->RemoveWatcher(1, PixelRect());
  service_->RemoveWatcher(1, corner);
}

}  // namespace
}  // namespace tessera
