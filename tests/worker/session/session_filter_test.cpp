// Windows of pictures in a worker's session.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/worker/session/session_driver.h"

namespace tessera {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::SizeIs;

v1::CoordinatorMessage FilterMessage(uint64_t id) {
  v1::CoordinatorMessage message;
  v1::FilterLease& lease = *message.mutable_filter();
  lease.set_id(id);
  lease.set_job("jobs/1");
  for (v1::Region* region :
       {lease.mutable_frame(), lease.mutable_window(), lease.mutable_bounds()}) {
    region->set_width(16);
    region->set_height(16);
  }
  lease.set_input_bytes(100);
  return message;
}

void Filtered(Driver& d, uint64_t task, uint64_t lease) {
  v1::FilteredWindow window;
  window.set_lease_id(lease);
  d.Step(session_event::Filtered{task, window});
}

TEST(SessionFilter, FiltersInTurnWithRenders) {
  Driver d(1);
  d.ServeScene({5});
  d.Receive(FilterMessage(6));
  d.Lease(7);
  d.Flush();
  ASSERT_THAT(d.renders, SizeIs(1));
  ASSERT_THAT(d.filters, SizeIs(1)) << "it needs no scene";
  EXPECT_EQ(d.filters[0].lease.id(), 6u);
  EXPECT_EQ(d.filters[0].worker, "workers/1");
  d.sent.clear();
  Filtered(d, d.filters[0].task, 6);
  ASSERT_THAT(d.sent, SizeIs(1));
  EXPECT_EQ(d.sent[0].filtered().lease_id(), 6u);
  d.Flush();
  EXPECT_THAT(d.renders, SizeIs(2));
  EXPECT_EQ(d.machine().load().leases, 2u);
}

TEST(SessionFilter, HeartbeatsNameIt) {
  Driver d(1);
  d.Serve();
  for (uint64_t id = 1; id <= 3; ++id) d.Receive(FilterMessage(id));
  d.sent.clear();
  d.Advance(seconds(3));
  ASSERT_THAT(d.sent, SizeIs(1));
  std::vector<v1::LeaseProgress::State> states;
  for (const auto& progress : d.sent[0].heartbeat().leases()) states.push_back(progress.state());
  EXPECT_THAT(states, ElementsAre(v1::LeaseProgress::STATE_RENDERING,
                                  v1::LeaseProgress::STATE_RENDERING,
                                  v1::LeaseProgress::STATE_WAITING));
}

TEST(SessionFilter, WhatIsRevokedIsCancelledAndNotSent) {
  Driver d(1);
  d.Serve();
  for (uint64_t id = 1; id <= 3; ++id) d.Receive(FilterMessage(id));
  v1::CoordinatorMessage revoke;
  for (const uint64_t id : {1, 3}) {
    revoke.mutable_revoke()->set_id(id);
    d.Receive(revoke);
  }
  EXPECT_THAT(d.cancelled, ElementsAre(d.filters.at(0).task));
  Filtered(d, d.filters[0].task, 1);
  EXPECT_THAT(d.sent, IsEmpty());
  Filtered(d, d.filters[1].task, 2);
  ASSERT_THAT(d.sent, SizeIs(1));
  EXPECT_EQ(d.machine().load().leases, 0u);
}

TEST(SessionFilter, WhatCannotBeFilteredIsDeclined) {
  Driver d(1);
  d.Serve();
  v1::CoordinatorMessage impossible = FilterMessage(1);
  impossible.mutable_filter()->mutable_bounds()->set_width(15);
  d.Receive(impossible);
  d.Receive(FilterMessage(2));
  d.Step(session_event::Filtered{d.filters.at(0).task, absl::NotFoundError("the lease is gone")});
  d.Flush();
  ASSERT_THAT(d.Declines(), SizeIs(2));
  EXPECT_EQ(d.Declines()[0].lease_id(), 1u);
  EXPECT_EQ(d.Declines()[1].detail(), "the lease is gone");
}

TEST(SessionFilter, DrainingFinishesWhatHasBegunAndDeclinesTheRest) {
  Driver d(1);
  d.Serve();
  for (uint64_t id = 1; id <= 3; ++id) d.Receive(FilterMessage(id));
  d.Step(session_event::DrainRequested{});
  d.Receive(FilterMessage(4));
  d.Flush();
  ASSERT_THAT(d.Declines(), SizeIs(2));
  EXPECT_EQ(d.half_closed, 0);
  Filtered(d, d.filters.at(0).task, 1);
  Filtered(d, d.filters.at(1).task, 2);
  d.Flush();
  EXPECT_EQ(d.half_closed, 1);
}

TEST(SessionFilter, NothingOfItOutlivesTheStream) {
  Driver d(1);
  d.Serve();
  d.Receive(FilterMessage(1));
  d.Step(session_event::StreamClosed{absl::UnavailableError("gone")});
  EXPECT_THAT(d.cancelled, ElementsAre(d.filters.at(0).task));
  Filtered(d, d.filters[0].task, 1);
  EXPECT_EQ(d.machine().load().leases, 0u);
  EXPECT_EQ(d.machine().load().deltas, 0u);
}

}  // namespace
}  // namespace tessera
