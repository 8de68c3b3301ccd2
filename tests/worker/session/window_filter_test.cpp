#include "worker/session/window_filter.h"

#include <gtest/gtest.h>

#include "core/denoise/denoise_frame.h"
#include "core/denoise/window_codec.h"
#include "tests/core/denoise/synthetic_frame.h"

namespace tessera {
namespace {

void Set(const PixelRect& rect, v1::Region* region) {
  region->set_x(rect.x_begin);
  region->set_y(rect.y_begin);
  region->set_width(rect.width());
  region->set_height(rect.height());
}

class WindowFilterTest : public ::testing::Test {
 protected:
  // A window of a frame that does not begin at 0, and ends within the halo.
  void SetUp() override {
    Offer(window_.Expand((*MakeDenoiser("nlm"))->halo_px(DenoiseQuality::kFinal))
              .Intersect(frame_));
  }
  void Offer(const PixelRect& bounds) {
    input_ = EncodeFilterInput(planes_, bounds);
    lease_.set_id(7);
    lease_.set_job("jobs/1");
    lease_.set_denoiser("nlm");
    lease_.set_quality(v1::QUALITY_FINAL);
    lease_.set_revision(3);
    Set(frame_, lease_.mutable_frame());
    Set(window_, lease_.mutable_window());
    Set(bounds, lease_.mutable_bounds());
    lease_.set_input_bytes(std::ssize(input_));
    lease_.set_input_checksum(PayloadChecksum(input_));
  }
  absl::StatusOr<v1::FilteredWindow> Filter() {
    return FilterWindow(lease_, input_, cancelled_, &parts_done_);
  }

  const PixelRect frame_{5, 7, 105, 67};
  const PixelRect window_{60, 20, 100, 60};
  const FramePlanes planes_ = MakeSyntheticFrame(frame_, 0.3f, 4, 1).planes;
  v1::FilterLease lease_;
  std::string input_;
  std::atomic<bool> cancelled_ = false;
  std::atomic<int64_t> parts_done_ = 0;
};

TEST_F(WindowFilterTest, IsTheFramesOwn) {
  const auto filtered = Filter();
  ASSERT_TRUE(filtered.ok()) << filtered.status();
  EXPECT_EQ(filtered->lease_id(), 7u);
  EXPECT_EQ(filtered->revision(), 3u);
  EXPECT_GT(parts_done_, 0);
  EXPECT_EQ(filtered->checksum(),
            FilteredChecksum({7, "jobs/1", 3, window_}, filtered->payload()));
  const auto planes = DecodeFiltered(window_, filtered->payload());
  ASSERT_TRUE(planes.ok());
  FilteredPlanes own(window_);
  (*MakeDenoiser("nlm"))->Filter(planes_, {frame_, DenoiseQuality::kFinal}, window_, &own);
  EXPECT_TRUE(SameBits(*planes, own));
}

TEST_F(WindowFilterTest, DamagedPlanesAreRefused) {
  input_[input_.size() / 2] ^= 1;
  EXPECT_TRUE(absl::IsInvalidArgument(Filter().status()));
  input_.resize(input_.size() / 2);
  EXPECT_TRUE(absl::IsInvalidArgument(Filter().status()));
}

TEST_F(WindowFilterTest, PlanesWithoutTheHaloAreRefused) {
  Offer(window_.Expand(1).Intersect(frame_));
  EXPECT_TRUE(absl::IsInvalidArgument(Filter().status()));
}

TEST_F(WindowFilterTest, UnknownFiltersAreRefused) {
  lease_.set_denoiser("of another version");
  EXPECT_TRUE(absl::IsInvalidArgument(Filter().status()));
}

TEST_F(WindowFilterTest, StopsWhenItIsTakenBack) {
  cancelled_ = true;
  EXPECT_TRUE(absl::IsCancelled(Filter().status()));
  EXPECT_EQ(parts_done_, 0);
}

TEST_F(WindowFilterTest, ImpossibleLeasesHaveFaults) {
  EXPECT_EQ(FaultOfFilterLease(lease_), "");
  const auto fault_with = [&](auto&& change) {
    v1::FilterLease lease = lease_;
    change(lease);
    return FaultOfFilterLease(lease);
  };
  EXPECT_NE(fault_with([](v1::FilterLease& l) { l.mutable_window()->set_width(0); }), "");
  EXPECT_NE(fault_with([](v1::FilterLease& l) { l.mutable_window()->set_x(0); }), "");
  EXPECT_NE(fault_with([](v1::FilterLease& l) { l.mutable_frame()->set_height(3); }), "");
  EXPECT_NE(fault_with([](v1::FilterLease& l) { l.set_input_bytes(int64_t{1} << 40); }), "");
  EXPECT_NE(fault_with([](v1::FilterLease& l) {
              for (v1::Region* r : {l.mutable_frame(), l.mutable_bounds(), l.mutable_window()}) {
                r->set_width(1 << 16);
                r->set_height(1 << 16);
              }
            }),
            "");
}

}  // namespace
}  // namespace tessera
