// Windows of pictures that are leased to workers: to whom, how many, and what becomes of those that
// do not come back.
#include <gtest/gtest.h>

#include <functional>
#include <memory>

#include "tests/server/simulated_farm.h"

namespace tessera {
namespace {

class FilterFarm : public ::testing::Test {
 protected:
  static CoordinatorConfig Config() {
    CoordinatorConfig config = SmallConfig();
    config.audit_rate = 1e-9;  // audits, of next to nothing
    return config;
  }
  SessionId ConnectFilter(int threads = 2,
                          const std::function<void(v1::Hello*)>& change = nullptr) {
    const SessionId session = farm.next_session++;
    v1::Hello hello = farm.MakeHello(absl::StrCat("host", session), threads);
    hello.set_filters(true);
    if (change) change(&hello);
    farm.Post(WorkerConnectedEvent{session, std::move(hello)});
    return session;
  }
  // A job that has all its samples: its workers are idle.
  JobId DoneJob() {
    const JobId job = farm.Create(SmallSettings(1));
    farm.answer_pictures = false;
    farm.RunAll();
    EXPECT_EQ(farm.Job(job).state(), v1::JOB_STATE_FINISHING);
    return job;
  }
  int64_t Room(JobId job) const {
    return farm.coordinator.FilterRoom(job, {farm.now_ms, farm.now_ms});
  }
  uint64_t Offer(JobId job) {
    FilterOfferEvent event{.ticket = ++last_ticket};
    event.lease.set_job(JobName(job));
    event.lease.set_revision(5);
    event.lease.mutable_window()->set_width(8);
    event.lease.mutable_window()->set_height(8);
    farm.Post(event);
    return last_ticket;
  }
  // The worker returns its oldest window.
  FilteredEvent Filter(SessionId session) {
    const v1::FilterLease lease = farm.workers[session].filters.front();
    farm.workers[session].filters.pop_front();
    FilteredEvent event{.session = session};
    event.filtered.set_lease_id(lease.id());
    event.filtered.set_job(lease.job());
    event.filtered.set_revision(lease.revision());
    *event.filtered.mutable_window() = lease.window();
    event.filtered.mutable_filter_time()->set_nanos(1000000);
    event.wire_bytes = 10;
    event.planes = std::make_shared<const FilteredPlanes>(RectOf(lease.window()));
    return event;
  }
  // Of the oldest answer: whether it has planes.
  bool TakeAnswer(uint64_t ticket) {
    EXPECT_FALSE(farm.filter_answers.empty());
    if (farm.filter_answers.empty()) return false;
    const FilterAnswerEffect answer = farm.filter_answers.front();
    farm.filter_answers.erase(farm.filter_answers.begin());
    EXPECT_EQ(answer.ticket, ticket);
    return answer.planes != nullptr;
  }

  SimulatedFarm farm{Config()};
  uint64_t last_ticket = 0;
};

TEST_F(FilterFarm, AWindowGoesOutAndComesBack) {
  const SessionId worker = ConnectFilter();
  const JobId job = DoneJob();
  EXPECT_EQ(Room(job), 4) << "two for each thread of an idle worker";
  const uint64_t ticket = Offer(job);
  EXPECT_EQ(Room(job), 3);
  ASSERT_EQ(farm.workers[worker].filters.size(), 1u);
  const LeaseId lease = farm.workers[worker].filters.front().id();
  EXPECT_EQ(farm.coordinator.FilterTicketOf("workers/1", lease), ticket);
  EXPECT_EQ(farm.coordinator.FilterTicketOf("workers/2", lease), 0u);
  EXPECT_EQ(farm.coordinator.FilterTicketOf("workers/1", lease + 1), 0u);
  EXPECT_EQ(farm.coordinator.ListWorkers({})[0].filter_leases(), 1);
  const FilteredEvent event = Filter(worker);
  EXPECT_TRUE(farm.Post(event).status.ok());
  EXPECT_TRUE(TakeAnswer(ticket));
  EXPECT_EQ(farm.coordinator.FilterTicketOf("workers/1", lease), 0u);
  EXPECT_TRUE(absl::IsAlreadyExists(farm.Post(event).status)) << "it counts once";
  EXPECT_TRUE(farm.filter_answers.empty());
  EXPECT_EQ(farm.coordinator.ListWorkers({})[0].filtered_windows(), 1);
  EXPECT_EQ(farm.coordinator.Totals().windows_filtered, 1);
  EXPECT_GT(farm.Job(job).progress().filter_core_seconds(), 0);
}

TEST_F(FilterFarm, OnlyWhoMayGetsWindows) {
  const JobId job = farm.Create(SmallSettings(1));
  farm.answer_pictures = false;
  const SessionId renderer = farm.Connect(1);
  farm.RunAll();
  farm.Disconnect(renderer);
  ConnectFilter(2, [](v1::Hello* hello) { hello->set_filters(false); });
  ConnectFilter(2, [](v1::Hello* hello) { hello->set_same_process(true); });
  ConnectFilter(2, [](v1::Hello* hello) { hello->set_arithmetic(0, kOtherArithmetic); });
  ConnectFilter(2, [](v1::Hello* hello) { hello->set_isa_classes(0, "x86-64-v2"); });
  farm.Post(DrainEvent{ConnectFilter()});
  EXPECT_EQ(Room(job), 0);
  EXPECT_FALSE(TakeAnswer(Offer(job))) << "refused at once";
  EXPECT_EQ(Room(99), 0) << "no such job";
  EXPECT_FALSE(TakeAnswer(Offer(99)));
  ConnectFilter(3);
  EXPECT_EQ(Room(job), 6);
  farm.now_ms += Config().lease_ttl_ms;
  EXPECT_EQ(Room(job), 0) << "it has been silent for long";
}

TEST_F(FilterFarm, RenderingKeepsItsShare) {
  const SessionId worker = ConnectFilter(2);
  const JobId job = farm.Create(SmallSettings(1 << 10));
  ASSERT_FALSE(farm.workers[worker].leases.empty());
  EXPECT_EQ(Room(job), 1) << "one at a time while it renders";
  const uint64_t ticket = Offer(job);
  EXPECT_EQ(Room(job), 0);
  FilteredEvent event = Filter(worker);
  event.filtered.mutable_filter_time()->set_nanos(300000000);
  farm.now_ms += 300;
  farm.Post(std::move(event));
  EXPECT_TRUE(TakeAnswer(ticket));
  // 0.3 s are 15 % of the worker's two threads in one second.
  farm.now_ms += 800;
  farm.Heartbeat(worker, 1);
  EXPECT_EQ(Room(job), 0);
  farm.now_ms += 100;
  farm.Heartbeat(worker, 2);
  EXPECT_EQ(Room(job), 1);
}

TEST_F(FilterFarm, WhatIsLostComesBackWithoutPlanes) {
  const SessionId worker = ConnectFilter();
  const JobId job = DoneJob();
  // Expired: nothing was heard of it.
  const uint64_t silent = Offer(job);
  farm.now_ms += Config().lease_ttl_ms / 2;
  HeartbeatEvent heartbeat{worker};
  heartbeat.leases.emplace_back().set_id(farm.workers[worker].filters.front().id());
  farm.Post(heartbeat);
  farm.now_ms += Config().lease_ttl_ms / 2;
  farm.Post(TickEvent{});
  EXPECT_TRUE(farm.filter_answers.empty()) << "renewed by being spoken of";
  const FilteredEvent late = Filter(worker);
  farm.now_ms += Config().lease_ttl_ms / 2;
  farm.Post(TickEvent{});
  EXPECT_FALSE(TakeAnswer(silent));
  EXPECT_TRUE(absl::IsAlreadyExists(farm.Post(late).status));
  EXPECT_EQ(Room(job), 0) << "put off for a while";
  farm.now_ms += Config().lease_ttl_ms;
  farm.Post(HeartbeatEvent{worker});
  EXPECT_EQ(Room(job), 4);
  // Declined.
  const uint64_t declined = Offer(job);
  DeclineEvent decline{worker, {}};
  decline.decline.set_lease_id(farm.workers[worker].filters.front().id());
  farm.Post(decline);
  EXPECT_FALSE(TakeAnswer(declined));
  EXPECT_EQ(Room(job), 0);
  farm.now_ms += 10 * Config().lease_ttl_ms;
  farm.Post(HeartbeatEvent{worker});
  // Gone with its worker.
  const uint64_t gone = Offer(job);
  farm.Disconnect(worker);
  EXPECT_FALSE(TakeAnswer(gone));
  EXPECT_EQ(farm.coordinator.Totals().filter_leases, 0);
  EXPECT_EQ(farm.coordinator.Totals().filter_leases_lost, 3);
}

TEST_F(FilterFarm, WithdrawnWindowsAreRevoked) {
  const SessionId worker = ConnectFilter();
  const JobId job = DoneJob();
  farm.Post(FilterWithdrawEvent{Offer(job)});
  EXPECT_TRUE(farm.workers[worker].filters.empty());
  EXPECT_EQ(Room(job), 4);
  farm.Post(FilterWithdrawEvent{Offer(job), true});
  EXPECT_TRUE(farm.filter_answers.empty()) << "no answer to what is not wanted any more";
  EXPECT_EQ(Room(job), 0) << "late: put off";
  farm.Post(FilterWithdrawEvent{77});
}

TEST_F(FilterFarm, AnswersToOtherQuestionsCloseTheSession) {
  const std::function<void(FilteredEvent*)> changes[] = {
      [](FilteredEvent* e) { e->filtered.set_job("jobs/9"); },
      [](FilteredEvent* e) { e->filtered.set_revision(4); },
      [](FilteredEvent* e) { e->filtered.mutable_window()->set_x(1); }};
  const JobId job = farm.Create(SmallSettings(1));
  farm.answer_pictures = false;
  for (const auto& change : changes) {
    const SessionId worker = ConnectFilter();
    farm.RunAll();
    const uint64_t ticket = Offer(job);
    FilteredEvent event = Filter(worker);
    change(&event);
    EXPECT_TRUE(absl::IsInvalidArgument(farm.Post(event).status));
    EXPECT_TRUE(farm.workers[worker].closed.has_value());
    EXPECT_FALSE(TakeAnswer(ticket));
  }
}

class FilterLiars : public FilterFarm, public ::testing::WithParamInterface<bool> {};
INSTANTIATE_TEST_SUITE_P(StopsByTime, FilterLiars, ::testing::Bool());

TEST_P(FilterLiars, AreBannedAndDecisionsTheyTouchedAreMadeAgain) {
  v1::JobSettings settings = SmallSettings(64);
  if (GetParam()) {
    settings.set_sampling(v1::SAMPLING_ADAPTIVE);
    settings.mutable_max_time()->set_seconds(1000);
  } else {
    settings.set_target_error(0.01);
  }
  settings.set_denoiser("none");
  farm.answer_pictures = false;
  const JobId job = farm.Create(settings);
  const SessionId honest = farm.Connect(1);
  farm.RunAll();
  const SessionId liar = ConnectFilter(1);
  const int64_t samples = farm.Job(job).progress().samples();
  ASSERT_GT(samples, 0);
  const uint64_t ticket = Offer(job);
  ASSERT_EQ(farm.workers[liar].filters.size(), 1u);
  EXPECT_TRUE(farm.Post(Filter(liar)).status.ok());
  EXPECT_TRUE(TakeAnswer(ticket));
  farm.Post(FilterLieEvent{absl::StrCat("host", liar)});
  EXPECT_EQ(farm.bans, std::vector<std::string>{absl::StrCat("host", liar)});
  ASSERT_TRUE(farm.workers[liar].closed.has_value());
  EXPECT_TRUE(absl::IsPermissionDenied(*farm.workers[liar].closed));
  EXPECT_LT(farm.Job(job).progress().samples(), samples) << "it starts over";
  EXPECT_FALSE(farm.workers[honest].leases.empty());
}

}  // namespace
}  // namespace tessera
