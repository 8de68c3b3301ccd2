#include "server/picture/picture.h"

#include <gtest/gtest.h>
#include <time.h>

#include <atomic>
#include <bit>
#include <chrono>
#include <cmath>
#include <cstring>
#include <functional>
#include <future>

#include "core/image/layers.h"
#include "server/coordinator/job_settings.h"
#include "server/picture/parallel.h"
#include "server/picture/picture_service.h"
#include "tests/server/simulated_farm.h"

namespace tessera {
namespace {

v1::JobSettings Settings(const std::string& denoiser) {
  v1::JobSettings settings = SmallSettings();
  settings.set_width(61);
  settings.set_height(45);
  settings.set_denoiser(denoiser);
  return settings;
}

std::vector<int64_t> AllTiles(const TileGrid& grid) {
  std::vector<int64_t> tiles;
  for (int64_t i = 0; i < grid.num_tiles(); ++i) tiles.push_back(i);
  return tiles;
}

bool SameBits(const Image& a, const Image& b) {
  for (size_t c = 0; c < a.channels.size(); ++c) {
    const ImageChannel &x = a.channels[c], &y = b.channels[c];
    if (x.uints != y.uints || x.floats.size() != y.floats.size()) return false;
    if (x.floats.empty()) continue;
    if (std::memcmp(x.floats.data(), y.floats.data(), 4 * x.floats.size()) != 0) return false;
  }
  return true;
}

Picture::TileSource From(const Film& film) {
  return [&film](int64_t tile) { return film.Fold(tile); };
}

// All layers and the estimate of the error.
void ExpectSame(const Picture& a, const Picture& b, const PixelRect& region) {
  std::vector<std::string> layers;
  for (const PictureLayer& layer : PictureLayers()) layers.emplace_back(layer.name);
  EXPECT_TRUE(SameBits(*a.Snapshot(region, layers), *b.Snapshot(region, layers)));
  EXPECT_EQ(std::bit_cast<uint64_t>(a.estimated_error()),
            std::bit_cast<uint64_t>(b.estimated_error()));
}

// Tiles in an odd order and in uneven groups, each ascending.
std::vector<std::vector<int64_t>> OddGroups(const TileGrid& grid) {
  std::vector<int64_t> order = AllTiles(grid);
  for (size_t i = 0; i < order.size(); ++i) {
    std::swap(order[i], order[(i * 7 + 3) % order.size()]);
  }
  std::vector<std::vector<int64_t>> groups;
  for (size_t i = 0; i < order.size();) {
    std::vector<int64_t> group;
    for (size_t n = 0; n < 1 + i % 4 && i < order.size(); ++n) group.push_back(order[i++]);
    std::ranges::sort(group);
    groups.push_back(std::move(group));
  }
  return groups;
}

// Decisions live on a grid of their own (C2): jobs that differ in tiles alone take the same.
TEST(Picture, ErrorsOfCellsDoNotDependOnTiles) {
  for (const std::string denoiser : {"none", "regression"}) {
    std::vector<CellError> first;
    for (const int tile_size : {8, 16, 61}) {
      v1::JobSettings settings = Settings(denoiser);
      settings.set_tile_size(tile_size);
      const TileGrid grid(RegionOf(settings), tile_size);
      const Film film = SyntheticFilm(1, grid, 8);
      Picture picture(settings);
      EXPECT_TRUE(std::isinf(ErrorBound(picture.CellErrors(), grid.region().area())));
      picture.Update(AllTiles(grid), From(film), DenoiseQuality::kFinal, 2);
      const std::vector<CellError> cells = picture.CellErrors();
      ASSERT_EQ(cells.size(), 4u * 3u);
      EXPECT_GE(ErrorBound(cells, grid.region().area()), 0.999 * picture.estimated_error());
      if (first.empty()) first = cells;
      for (size_t i = 0; i < cells.size(); ++i) {
        EXPECT_GT(cells[i].noise, 0);
        EXPECT_EQ(std::bit_cast<uint64_t>(cells[i].error),
                  std::bit_cast<uint64_t>(first[i].error));
        EXPECT_EQ(std::bit_cast<uint64_t>(cells[i].noise),
                  std::bit_cast<uint64_t>(first[i].noise));
      }
    }
  }
}

TEST(Picture, IncrementalEqualsFromScratch) {
  for (const std::string& denoiser : DenoiserNames()) {
    SCOPED_TRACE(denoiser);
    const v1::JobSettings settings = Settings(denoiser);
    const TileGrid grid(RegionOf(settings), settings.tile_size());
    const Film two = SyntheticFilm(1, grid, 2), eight = SyntheticFilm(1, grid, 8);
    Picture grown(settings), fresh(settings);
    grown.Update(AllTiles(grid), From(two), DenoiseQuality::kFinal, 2);
    for (const std::vector<int64_t>& group : OddGroups(grid)) {
      grown.Update(group, From(eight), DenoiseQuality::kFinal, 1);
    }
    fresh.Update(AllTiles(grid), From(eight), DenoiseQuality::kFinal, 2);
    ExpectSame(grown, fresh, grid.region());
  }
}

TEST(Picture, RefinedDoesNotDependOnPreviews) {
  for (const std::string& denoiser : DenoiserNames()) {
    SCOPED_TRACE(denoiser);
    const v1::JobSettings settings = Settings(denoiser);
    const TileGrid grid(RegionOf(settings), settings.tile_size());
    const Film two = SyntheticFilm(1, grid, 2), eight = SyntheticFilm(1, grid, 8);
    Picture seen(settings), fresh(settings);
    EXPECT_TRUE(seen.is_refined());
    seen.Update(AllTiles(grid), From(two), DenoiseQuality::kPreview, 2);
    int round = 0;
    for (const std::vector<int64_t>& group : OddGroups(grid)) {
      seen.Update(group, From(eight),
                  ++round % 5 == 0 ? DenoiseQuality::kFinal : DenoiseQuality::kPreview, 2);
      EXPECT_EQ(seen.is_refined(), round % 5 == 0);
    }
    // A preview of everything, so that all is to be done again.
    seen.Update(AllTiles(grid), From(eight), DenoiseQuality::kPreview, 1);
    EXPECT_FALSE(seen.is_refined());
    const uint64_t version = seen.version();
    seen.Update({}, From(eight), DenoiseQuality::kFinal, 2);
    EXPECT_TRUE(seen.is_refined());
    EXPECT_GT(seen.version(), version);
    fresh.Update(AllTiles(grid), From(eight), DenoiseQuality::kFinal, 1);
    ExpectSame(seen, fresh, grid.region());
  }
}

// What a preview's halo does not reach is not filtered again, and need not be. The frame is wider
// than the halo on both sides of a tile.
TEST(Picture, PreviewsHaveNoStalePixels) {
  for (const std::string& denoiser : DenoiserNames()) {
    SCOPED_TRACE(denoiser);
    v1::JobSettings settings = Settings(denoiser);
    settings.set_width(150);
    const TileGrid grid(RegionOf(settings), settings.tile_size());
    const Film two = SyntheticFilm(1, grid, 2), eight = SyntheticFilm(1, grid, 8);
    Picture seen(settings), fresh(settings);
    seen.Update(AllTiles(grid), From(two), DenoiseQuality::kPreview, 2);
    for (const std::vector<int64_t>& group : OddGroups(grid)) {
      seen.Update(group, From(eight), DenoiseQuality::kPreview, 2);
    }
    fresh.Update(AllTiles(grid), From(eight), DenoiseQuality::kPreview, 1);
    ExpectSame(seen, fresh, grid.region());
  }
}

TEST(Picture, RefinedInSlicesIsTheSame) {
  for (const std::string& denoiser : DenoiserNames()) {
    SCOPED_TRACE(denoiser);
    const v1::JobSettings settings = Settings(denoiser);
    const TileGrid grid(RegionOf(settings), settings.tile_size());
    const Film two = SyntheticFilm(1, grid, 2), eight = SyntheticFilm(1, grid, 8);
    Picture sliced(settings), fresh(settings);
    sliced.Absorb(AllTiles(grid), From(two), 1);
    sliced.Refine(500, 2);
    EXPECT_FALSE(sliced.HasShown(std::nullopt)) << "it is not whole yet";
    // Newer samples come while it is being refined.
    sliced.Absorb(AllTiles(grid), From(eight), 2);
    int slices = 0;
    for (; !sliced.is_refined(); ++slices) sliced.Refine(500, 1 + slices % 2);
    EXPECT_GE(slices, 61 * 45 / 500 / 2);
    EXPECT_TRUE(sliced.HasShown(std::nullopt));
    fresh.Update(AllTiles(grid), From(eight), DenoiseQuality::kFinal, 1);
    ExpectSame(sliced, fresh, grid.region());
  }
}

TEST(Picture, PreviewOfAJobOfPreviewQualityIsRefined) {
  v1::JobSettings settings = Settings("bilateral");
  const TileGrid grid(RegionOf(settings), settings.tile_size());
  const Film eight = SyntheticFilm(1, grid, 8);
  Picture coarse(settings);
  coarse.Update(AllTiles(grid), From(eight), DenoiseQuality::kPreview, 1);
  settings.set_quality(v1::QUALITY_PREVIEW);
  Picture preview(settings), asked(settings);
  preview.Update(AllTiles(grid), From(eight), DenoiseQuality::kPreview, 1);
  EXPECT_TRUE(preview.is_refined());
  asked.Update(AllTiles(grid), From(eight), DenoiseQuality::kFinal, 1);
  ExpectSame(preview, asked, grid.region());
  ExpectSame(preview, coarse, grid.region());
}

TEST(Picture, TilesWithoutSamplesAreUnknown) {
  const v1::JobSettings settings = Settings("bilateral");
  const TileGrid grid(RegionOf(settings), settings.tile_size());
  const Film full = SyntheticFilm(1, grid, 4);
  Film partial(grid);
  const PixelRect known = grid.WindowOf(0);
  ASSERT_TRUE(partial.Accept(0, full.Fold(0)).ok());
  Picture picture(settings);
  picture.Update(AllTiles(grid), From(Film(grid)), DenoiseQuality::kPreview, 1);
  EXPECT_EQ(picture.spp(), 0);
  EXPECT_EQ(picture.version(), 1u);
  picture.Update(AllTiles(grid), From(partial), DenoiseQuality::kPreview, 2);
  EXPECT_NEAR(picture.spp(),
              4.0 * static_cast<double>(known.area()) / static_cast<double>(grid.region().area()),
              1e-12);
  EXPECT_EQ(picture.estimated_error(), 0);
  const Image image = *picture.Snapshot(grid.region(), {"samples", "error", "variance"});
  for (int y = 0; y < settings.height(); ++y) {
    for (int x = 0; x < settings.width(); ++x) {
      const auto i = static_cast<size_t>(grid.region().IndexOf(x, y));
      EXPECT_EQ(image.channels[0].uints[i], known.Contains(x, y) ? 4u : 0u);
      EXPECT_EQ(std::isfinite(image.channels[1].floats[i]), known.Contains(x, y));
      EXPECT_EQ(std::isfinite(image.channels[4].floats[i]), known.Contains(x, y));
    }
  }
}

TEST(Picture, KnowsNoErrorBeforeBothHalvesHaveSamples) {
  const v1::JobSettings settings = Settings("none");
  const TileGrid grid(RegionOf(settings), settings.tile_size());
  Picture picture(settings);
  EXPECT_EQ(picture.estimated_error(), 0);
  const Film one = SyntheticFilm(1, grid, 1), eight = SyntheticFilm(1, grid, 8);
  picture.Update(AllTiles(grid), From(one), DenoiseQuality::kFinal, 1);
  EXPECT_EQ(picture.estimated_error(), 0);
  picture.Update(AllTiles(grid), From(eight), DenoiseQuality::kFinal, 1);
  EXPECT_GT(picture.estimated_error(), 0);
  EXPECT_LT(picture.estimated_error(), 1);
}

// A job whose film the test sets.
struct OneJob {
  explicit OneJob(const v1::JobSettings& settings_in)
      : settings(settings_in),
        film(std::make_shared<Film>(TileGrid(RegionOf(settings), settings.tile_size()))) {}

  PictureSource Source() {
    PictureSource source;
    source.view = [this](JobId) {
      std::lock_guard lock(mu);
      return std::make_unique<PictureSource::JobView>(
          PictureSource::JobView{settings, film->samples(), is_sampling, film,
                                 film->samples() > 0});
    };
    source.fold_tile = [](const Film& from, int64_t tile) { return from.Fold(tile); };
    source.on_picture = [this](const PictureEvent& event) {
      std::lock_guard lock(mu);
      last = event;
    };
    source.on_finished = [this](const JobFinishedEvent&) { finished.set_value(); };
    return source;
  }

  void Grow(PictureService& service, std::shared_ptr<const Film> more, bool sampling) {
    {
      std::lock_guard lock(mu);
      film = std::move(more);
      is_sampling = sampling;
    }
    for (int64_t tile = 0; tile < film->grid().num_tiles(); ++tile) service.TileChanged(1, tile);
  }

  const v1::JobSettings settings;
  std::mutex mu;  // guards the next three
  std::shared_ptr<const Film> film;
  bool is_sampling = true;
  PictureEvent last;
  std::promise<void> finished;
};

std::shared_ptr<const Picture> FetchNow(PictureService& service, bool wait) {
  std::promise<std::shared_ptr<const Picture>> promise;
  service.Fetch(1, std::nullopt, wait,
                [&](std::shared_ptr<const Picture> picture) { promise.set_value(picture); });
  return promise.get_future().get();
}

// While job 1's refinement is under way, somebody gets the first preview of job 2: the refinement
// goes on only then.
TEST(PictureService, APreviewWaitsForNoOtherJobsRefinement) {
  const v1::JobSettings settings = Settings("none");
  OneJob refined(settings), seen(settings);
  std::promise<void> fetched, finished;
  std::future_status status = std::future_status::timeout;
  std::function<void()> on_first_fold;
  std::once_flag first_fold;
  PictureSource source = refined.Source();
  source.view = [&](JobId job) {
    const OneJob& of = job == 1 ? refined : seen;
    return std::make_unique<PictureSource::JobView>(
        PictureSource::JobView{of.settings, 0, true, of.film});
  };
  source.fold_tile = [&](const Film& film, int64_t tile) {
    if (&film == refined.film.get()) std::call_once(first_fold, on_first_fold);
    return film.Fold(tile);
  };
  source.on_finished = [&](const JobFinishedEvent&) { finished.set_value(); };
  refined.film = std::make_shared<const Film>(
      SyntheticFilm(1, TileGrid(RegionOf(settings), settings.tile_size()), 1));
  PictureService service(std::move(source), 1);
  on_first_fold = [&] {
    service.Fetch(2, std::nullopt, false,
                  [&](std::shared_ptr<const Picture>) { fetched.set_value(); });
    status = fetched.get_future().wait_for(std::chrono::seconds(60));
  };
  service.Finish(1);
  finished.get_future().wait();
  EXPECT_EQ(status, std::future_status::ready);
}

// Thousands may be watched while they wait for their turn; each picture would be gigabytes.
TEST(PictureService, AWatchedJobWithoutSamplesHasNoPicture) {
  const v1::JobSettings settings = Settings("none");
  OneJob job(settings);
  job.is_sampling = false;  // paused
  PictureSource source = job.Source();
  std::promise<void> viewed, drawn;
  std::once_flag first_view, first_fold;
  std::atomic<int> folds = 0;
  source.view = [&, view = source.view](JobId id) {
    if (id == 1) std::call_once(first_view, [&] { viewed.set_value(); });
    return view(id);
  };
  source.fold_tile = [&](const Film& film, int64_t tile) {
    ++folds;
    if (film.samples() > 0) std::call_once(first_fold, [&] { drawn.set_value(); });
    return film.Fold(tile);
  };
  PictureService service(std::move(source), 1);
  service.AddWatcher(1, std::nullopt);
  viewed.get_future().wait();
  // Another job's round comes after that of job 1.
  std::promise<void> done;
  service.Fetch(2, std::nullopt, false, [&](std::shared_ptr<const Picture>) { done.set_value(); });
  done.get_future().wait();
  EXPECT_EQ(folds, job.film->grid().num_tiles()) << "of job 2 only, which was asked for";
  job.Grow(service,
           std::make_shared<const Film>(
               SyntheticFilm(1, TileGrid(RegionOf(settings), settings.tile_size()), 1)),
           true);
  EXPECT_EQ(drawn.get_future().wait_for(std::chrono::seconds(60)), std::future_status::ready);
  service.Stop();
}

TEST(PictureService, LastPictureIsTheJobsAfterPreviews) {
  const v1::JobSettings settings = Settings("bilateral");
  const TileGrid grid(RegionOf(settings), settings.tile_size());
  OneJob job(settings);
  PictureService service(job.Source(), 2);
  EXPECT_EQ(FetchNow(service, false)->spp(), 0);
  job.Grow(service, std::make_shared<const Film>(SyntheticFilm(1, grid, 2)), true);
  // A blank picture is not served once there are samples.
  const auto preview = FetchNow(service, false);
  EXPECT_EQ(preview->spp(), 2);
  EXPECT_FALSE(preview->is_refined());
  const auto waited = FetchNow(service, true);
  EXPECT_TRUE(waited->is_refined());
  job.Grow(service, std::make_shared<const Film>(SyntheticFilm(1, grid, 8)), false);
  service.Finish(1);
  job.finished.get_future().wait();
  const auto last = FetchNow(service, false);
  EXPECT_EQ(last->spp(), 8);
  EXPECT_TRUE(last->is_refined());
  Picture fresh(settings);
  fresh.Update(AllTiles(grid), From(*job.film), DenoiseQuality::kFinal, 1);
  ExpectSame(*last, fresh, grid.region());
  std::lock_guard lock(job.mu);
  EXPECT_EQ(job.last.estimated_error, fresh.estimated_error());
  EXPECT_GT(job.last.filter_core_seconds, 0);
}

// The last delta of an epoch may be merged just after a round has read the job.
TEST(PictureService, AnEvaluationThatIsAskedForDuringARoundIsAnswered) {
  const v1::JobSettings settings = Settings("none");
  const TileGrid grid(RegionOf(settings), settings.tile_size());
  OneJob job(settings);
  PictureSource source = job.Source();
  PictureService* running = nullptr;
  source.view = [&, view = source.view](JobId id) {
    auto read = view(id);
    if (read->samples == 0) {
      job.Grow(*running, std::make_shared<const Film>(SyntheticFilm(1, grid, 8)), true);
      running->Evaluate(id);
    }
    return read;
  };
  std::promise<void> answered;
  source.on_picture = [&, is_first = true](const PictureEvent& event) mutable {
    if (event.samples == 8 * grid.region().area() && is_first) {
      is_first = false;
      answered.set_value();
    }
  };
  PictureService service(source, 1);
  running = &service;
  FetchNow(service, false);
  EXPECT_EQ(answered.get_future().wait_for(std::chrono::seconds(5)), std::future_status::ready);
  service.Stop();
}

// Of two jobs that are asked for without end, each gets its turn.
TEST(PictureService, AJobInDemandKeepsNoOtherWaiting) {
  OneJob job(Settings("none"));
  PictureService service(job.Source(), 1);
  std::atomic<bool> is_over{false};
  std::function<void(std::shared_ptr<const Picture>)> again = [&](const auto& picture) {
    if (picture != nullptr && !is_over) service.Fetch(1, std::nullopt, true, again);
  };
  service.Fetch(1, std::nullopt, true, again);
  service.Fetch(1, std::nullopt, true, again);
  std::promise<void> served;
  service.Fetch(2, std::nullopt, true, [&](const auto&) { served.set_value(); });
  EXPECT_EQ(served.get_future().wait_for(std::chrono::seconds(5)), std::future_status::ready);
  is_over = true;
  service.Stop();
}

TEST(ParallelFor, CallsEachOnce) {
  for (const int num_threads : {1, 3}) {
    for (const size_t count : {size_t{0}, size_t{2}, size_t{100}}) {
      std::vector<std::atomic<int>> calls(count);
      EXPECT_GE(ParallelFor(count, num_threads, [&](size_t i) { ++calls[i]; }), 0);
      for (const std::atomic<int>& n : calls) EXPECT_EQ(n, 1);
    }
  }
}

TEST(ParallelFor, WaitingCostsNothing) {
  // The first call blocks until the second has spun through 20 ms of its own CPU clock.
  std::promise<void> spun;
  const auto cpu_seconds = [] {
    timespec now = {};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
  };
  double spent = 0;
  const double total = ParallelFor(2, 2, [&](size_t i) {
    if (i == 0) return spun.get_future().wait();
    const double begin = cpu_seconds();
    while (cpu_seconds() - begin < 0.02) {
    }
    spent = cpu_seconds() - begin;
    spun.set_value();
  });
  EXPECT_GE(total, spent);
  EXPECT_LT(total, 1.5 * spent);
}

TEST(Picture, RefusesWrongRegionsAndLayers) {
  const v1::JobSettings settings = Settings("none");
  const Picture picture(settings);
  EXPECT_TRUE(absl::IsInvalidArgument(
      picture.Snapshot(PixelRect::FromSize(60, 0, 2, 2), {"final"}).status()));
  EXPECT_TRUE(absl::IsInvalidArgument(
      picture.Snapshot(PixelRect::FromSize(0, 0, 2, 2), {"magic"}).status()));
}

TEST(JoinTiles, CoversExactlyTheTiles) {
  const TileGrid grid(PixelRect::FromSize(0, 0, 50, 30), 8);
  const std::vector<int64_t> tiles = {0, 1, 6, 7, 8, 13, 20, 27};
  int64_t area = 0;
  for (const PixelRect& rect : JoinTiles(grid, tiles)) area += rect.area();
  int64_t expected = 0;
  for (const int64_t tile : tiles) expected += grid.WindowOf(tile).area();
  EXPECT_EQ(area, expected);
  EXPECT_EQ(JoinTiles(grid, AllTiles(grid)).size(), 1u);
}

}  // namespace
}  // namespace tessera
