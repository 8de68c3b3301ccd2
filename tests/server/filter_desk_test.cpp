#include "server/picture/filter_desk.h"

#include <gtest/gtest.h>

#include <memory>
#include <string>
#include <vector>

namespace tessera {
namespace {

struct Desk {
  explicit Desk(FilterOn filter_on = FilterOn::kAuto)
      : desk({filter_on, 0, 0}, [this](Event event) { events.push_back(std::move(event)); },
             [](JobId) { return int64_t{3}; }) {}
  FilterDesk desk;
  std::vector<Event> events;
};

FilterOffer SomeOffer() {
  return {.frame = {0, 0, 8, 8},
          .window = {0, 0, 4, 4},
          .bounds = {0, 0, 6, 6},
          .denoiser = "none",
          .input = std::make_shared<const std::string>("planes")};
}

// The server's own cores first: workers are asked once these have more to do than they clear soon.
TEST(FilterDesk, AutoAsksWorkersForABacklogOnly) {
  Desk farm;
  const LeasedWindows windows(farm.desk, 1);
  EXPECT_EQ(windows.Room(), 3);
  EXPECT_TRUE(windows.Pays(1 << 20, 1 << 16, 2)) << "by a guess, until it is measured";
  farm.desk.NoteOwnSpeed(1000, 0.01);  // 10 us
  EXPECT_FALSE(windows.Pays(65536, 65536, 2)) << "about to be done here";
  EXPECT_FALSE(windows.Pays(65536 + 19000, 65536, 2)) << "95 ms of two cores";
  EXPECT_TRUE(windows.Pays(65536 + 21000, 65536, 2)) << "105 ms";
  EXPECT_FALSE(windows.Pays(65536 + 21000, 65536, 4));
}

TEST(FilterDesk, TheFlagDecides) {
  Desk server(FilterOn::kServer), workers(FilterOn::kWorkers);
  EXPECT_EQ(LeasedWindows(server.desk, 1).Room(), 0);
  EXPECT_TRUE(LeasedWindows(workers.desk, 1).Pays(1, 100, 2));
}

TEST(FilterDesk, PlanesAreKeptUntilTheAnswer) {
  Desk farm;
  LeasedWindows windows(farm.desk, 7);
  windows.Offer(SomeOffer());
  ASSERT_EQ(farm.events.size(), 1u);
  const auto& offer = std::get<FilterOfferEvent>(farm.events[0]);
  EXPECT_EQ(offer.lease.job(), "jobs/7");
  EXPECT_EQ(offer.lease.input_bytes(), 6);
  ASSERT_NE(farm.desk.InputOf(offer.ticket), nullptr);
  EXPECT_EQ(*farm.desk.InputOf(offer.ticket), "planes");
  EXPECT_EQ(farm.desk.InputOf(offer.ticket + 1), nullptr);
  EXPECT_FALSE(windows.empty());
  farm.desk.Answer({offer.ticket});
  EXPECT_EQ(farm.desk.InputOf(offer.ticket), nullptr);
  const std::vector<LeasedWindows::Answer> answers = windows.Take();
  ASSERT_EQ(answers.size(), 1u);
  EXPECT_EQ(answers[0].window, (PixelRect{0, 0, 4, 4}));
  EXPECT_EQ(answers[0].planes, nullptr);
  EXPECT_TRUE(windows.empty());
  farm.desk.Answer({offer.ticket});  // it was answered
  EXPECT_TRUE(windows.empty());
}

}  // namespace
}  // namespace tessera
