// A picture that workers help to filter is the server's own, bit for bit: for any number of
// workers, any order of their answers, and whatever is lost, late or a lie.
#include "server/picture/leased_windows.h"

#include <gtest/gtest.h>

#include <bit>
#include <cstring>
#include <deque>
#include <functional>
#include <random>
#include <string>
#include <vector>

#include "core/denoise/frame_filter.h"
#include "core/denoise/window_codec.h"
#include "core/image/layers.h"
#include "server/coordinator/job_settings.h"
#include "server/picture/filter_desk.h"
#include "server/picture/picture.h"
#include "tests/server/simulated_farm.h"

namespace tessera {
namespace {

// Three windows of 256 pixels in a row, and a bit.
v1::JobSettings WideSettings(const std::string& denoiser) {
  v1::JobSettings settings = SmallSettings();
  settings.set_width(523);
  settings.set_height(21);
  settings.set_denoiser(denoiser);
  return settings;
}

std::vector<int64_t> AllTiles(const TileGrid& grid) {
  std::vector<int64_t> tiles;
  for (int64_t i = 0; i < grid.num_tiles(); ++i) tiles.push_back(i);
  return tiles;
}

Picture::TileSource From(const Film& film) {
  return [&film](int64_t tile) { return film.Fold(tile); };
}

void ExpectSame(const Picture& a, const Picture& b) {
  std::vector<std::string> layers;
  for (const PictureLayer& layer : PictureLayers()) layers.emplace_back(layer.name);
  const Image x = *a.Snapshot(a.region(), layers), y = *b.Snapshot(b.region(), layers);
  for (size_t c = 0; c < x.channels.size(); ++c) {
    const ImageChannel &p = x.channels[c], &q = y.channels[c];
    EXPECT_EQ(p.uints, q.uints);
    ASSERT_EQ(p.floats.size(), q.floats.size());
    if (p.floats.empty()) continue;
    EXPECT_EQ(std::memcmp(p.floats.data(), q.floats.data(), 4 * p.floats.size()), 0);
  }
  EXPECT_EQ(std::bit_cast<uint64_t>(a.estimated_error()),
            std::bit_cast<uint64_t>(b.estimated_error()));
}

PixelRect Rect(const v1::Region& r) { return RectOf(r); }

// Workers that hold what is offered until the test has them answer.
class Workers {
 public:
  explicit Workers(int64_t room, double audit_rate = 0)
      : desk({FilterOn::kWorkers, audit_rate, 1}, [this](Event event) { Post(event); },
             [this](JobId) { return room_left; }),
        room_left(room) {}

  // What the worker makes of the window that it has had `index` longest; a lie has other bits.
  void Answer(size_t index, bool is_lie = false) {
    const FilterOfferEvent offer = held.at(index);
    held.erase(held.begin() + static_cast<std::ptrdiff_t>(index));
    ++room_left;
    const v1::FilterLease& lease = offer.lease;
    const auto input = desk.InputOf(offer.ticket);
    ASSERT_NE(input, nullptr);
    EXPECT_EQ(lease.input_bytes(), std::ssize(*input));
    EXPECT_EQ(lease.input_checksum(), PayloadChecksum(*input));
    const auto denoiser = *MakeDenoiser(lease.denoiser());
    const auto planes = DecodeFilterInput(Rect(lease.bounds()), *input);
    ASSERT_TRUE(planes.ok());
    FilteredPlanes filtered(Rect(lease.window()));
    denoiser->Filter(*planes, {Rect(lease.frame()), DenoiseQuality::kFinal}, filtered.bounds,
                     &filtered);
    if (is_lie) filtered.color[0][filtered.color[0].size() / 2] += 1;
    desk.Answer({offer.ticket, std::make_shared<const FilteredPlanes>(filtered), "host"});
    ++answered;
  }
  void Lose(size_t index) {
    const uint64_t ticket = held.at(index).ticket;
    held.erase(held.begin() + static_cast<std::ptrdiff_t>(index));
    ++room_left;
    desk.Answer({ticket});
  }

  FilterDesk desk;
  int64_t room_left;
  std::deque<FilterOfferEvent> held;
  std::vector<std::string> lies;
  int answered = 0;
  int withdrawn = 0;
  std::function<void(const std::string&)> on_lie;

 private:
  void Post(const Event& event) {
    if (const auto* const offer = std::get_if<FilterOfferEvent>(&event)) {
      if (room_left == 0) return desk.Answer({offer->ticket});
      --room_left;
      held.push_back(*offer);
    } else if (const auto* const withdraw = std::get_if<FilterWithdrawEvent>(&event)) {
      ++withdrawn;
      room_left += static_cast<int64_t>(std::erase_if(
          held, [&](const auto& window) { return window.ticket == withdraw->ticket; }));
    } else if (const auto* const lie = std::get_if<FilterLieEvent>(&event)) {
      lies.push_back(lie->host);
      if (on_lie) on_lie(lie->host);
    }
  }
};

class LeasedPicture : public ::testing::TestWithParam<std::string> {};
INSTANTIATE_TEST_SUITE_P(Filters, LeasedPicture, ::testing::Values("regression", "nlm", "none"),
                         [](const auto& filter) { return filter.param; });

TEST_P(LeasedPicture, IsTheServersOwnWhoeverHelps) {
  const v1::JobSettings settings = WideSettings(GetParam());
  const TileGrid grid(RegionOf(settings), settings.tile_size());
  const Film two = SyntheticFilm(1, grid, 2), eight = SyntheticFilm(1, grid, 8);
  Picture own(settings);
  own.Update(AllTiles(grid), From(eight), DenoiseQuality::kFinal, 1);
  for (const int64_t room : {0, 1, 5}) {
    SCOPED_TRACE(room);
    std::mt19937 random(static_cast<uint32_t>(room));
    Workers workers(room);
    Picture picture(settings);
    int slices = 0;
    for (const Film* film : {&two, &eight}) {
      LeasedWindows leased(workers.desk, 1);
      picture.Absorb(AllTiles(grid), From(*film), 1);
      for (; !picture.is_refined(); ++slices) {
        ASSERT_LT(slices, 10000);
        picture.Refine(2000, 1, &leased);
        if (workers.held.empty() || random() % 3 == 0) continue;
        const size_t index = random() % workers.held.size();
        random() % 4 == 0 ? workers.Lose(index) : workers.Answer(index);
      }
    }
    EXPECT_EQ(workers.answered > 0, room > 0);
    ExpectSame(picture, own);
  }
}

// Nobody answers: the server takes all back, in the end.
TEST(LeasedWindows, LateWindowsAreTakenBack) {
  const v1::JobSettings settings = WideSettings("none");
  const TileGrid grid(RegionOf(settings), settings.tile_size());
  const Film eight = SyntheticFilm(1, grid, 8);
  Workers workers(100);
  Picture picture(settings), own(settings);
  own.Update(AllTiles(grid), From(eight), DenoiseQuality::kFinal, 1);
  LeasedWindows leased(workers.desk, 1);
  picture.Absorb(AllTiles(grid), From(eight), 1);
  picture.Refine(1 << 16, 1, &leased);
  EXPECT_FALSE(picture.is_refined());
  EXPECT_FALSE(workers.held.empty());
  while (!picture.is_refined()) picture.Refine(1 << 16, 1, &leased);
  EXPECT_EQ(workers.answered, 0);
  EXPECT_GE(workers.withdrawn, 3);
  ExpectSame(picture, own);
}

TEST(LeasedWindows, EndingTakesAllBack) {
  const v1::JobSettings settings = WideSettings("none");
  const TileGrid grid(RegionOf(settings), settings.tile_size());
  const Film eight = SyntheticFilm(1, grid, 8);
  Workers workers(100);
  Picture picture(settings);
  picture.Absorb(AllTiles(grid), From(eight), 1);
  {
    LeasedWindows leased(workers.desk, 1);
    picture.Refine(100, 1, &leased);
    EXPECT_FALSE(workers.held.empty());
  }
  EXPECT_TRUE(workers.held.empty());
  EXPECT_GT(workers.withdrawn, 0);
}

// Every answer is audited: lies are found, and never seen.
TEST(LeasedWindows, AuditsFindLies) {
  const v1::JobSettings settings = WideSettings("nlm");
  const TileGrid grid(RegionOf(settings), settings.tile_size());
  const Film eight = SyntheticFilm(1, grid, 8);
  Workers workers(2, 1);
  Picture picture(settings), own(settings);
  own.Update(AllTiles(grid), From(eight), DenoiseQuality::kFinal, 1);
  LeasedWindows leased(workers.desk, 1);
  picture.Absorb(AllTiles(grid), From(eight), 1);
  int lies = 0;
  while (!picture.is_refined()) {
    picture.Refine(2000, 1, &leased);
    if (workers.held.empty()) continue;
    workers.Answer(0, lies++ == 0);
  }
  EXPECT_EQ(workers.lies, std::vector<std::string>{"host"});
  EXPECT_EQ(workers.desk.totals().windows_audited, workers.answered);
  ExpectSame(picture, own);
}

// A lie that no audit has met is out of the picture once its host is known.
TEST(LeasedWindows, WhatABannedHostHasFilteredIsFilteredAgain) {
  const v1::JobSettings settings = WideSettings("nlm");
  const TileGrid grid(RegionOf(settings), settings.tile_size());
  const Film eight = SyntheticFilm(1, grid, 8);
  Workers workers(2);
  Picture picture(settings), own(settings);
  own.Update(AllTiles(grid), From(eight), DenoiseQuality::kFinal, 1);
  LeasedWindows leased(workers.desk, 1);
  picture.Absorb(AllTiles(grid), From(eight), 1);
  while (!picture.is_refined()) {
    picture.Refine(2000, 1, &leased);
    if (!workers.held.empty()) workers.Answer(0, true);
  }
  picture.Distrust("another host");
  EXPECT_TRUE(picture.is_refined());
  picture.Distrust("host");
  EXPECT_FALSE(picture.is_refined());
  workers.room_left = 0;
  while (!picture.is_refined()) picture.Refine(2000, 1, &leased);
  ExpectSame(picture, own);
}

}  // namespace
}  // namespace tessera
