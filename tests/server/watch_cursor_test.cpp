#include "server/rpc/watch_cursor.h"

#include <gtest/gtest.h>

namespace tessera {
namespace {

v1::Job JobAt(uint64_t incarnation, uint64_t counter, v1::JobState state = v1::JOB_STATE_RUNNING) {
  v1::Job job;
  job.set_state(state);
  job.mutable_revision()->set_incarnation(incarnation);
  job.mutable_revision()->set_counter(counter);
  job.mutable_settings()->set_width(7);
  return job;
}

v1::WatchJobRequest From(uint64_t incarnation, uint64_t counter) {
  v1::WatchJobRequest request;
  request.mutable_from_revision()->set_incarnation(incarnation);
  request.mutable_from_revision()->set_counter(counter);
  request.set_only_changes(true);
  return request;
}

TEST(WatchCursor, SendsWhatIsNewerAndNotMoreOftenThanAskedFor) {
  WatchCursor cursor(From(2, 5));
  EXPECT_TRUE(cursor.IsDue(0));
  v1::Job same = JobAt(2, 5), newer = JobAt(2, 6), next = JobAt(2, 7);
  EXPECT_FALSE(cursor.Take(&same, 0));
  EXPECT_FALSE(cursor.IsDue(1000)) << "nothing has changed";
  cursor.NoteChange();
  ASSERT_TRUE(cursor.Take(&newer, 1000));
  EXPECT_TRUE(newer.has_settings()) << "the first of the stream is whole";
  cursor.NoteChange();
  EXPECT_FALSE(cursor.IsDue(1099));
  ASSERT_TRUE(cursor.IsDue(1100));
  ASSERT_TRUE(cursor.Take(&next, 1100));
  EXPECT_FALSE(next.has_settings()) << "known";
}

TEST(WatchCursor, AnotherIncarnationIsNewerWhateverItsCounter) {
  WatchCursor cursor(From(2, 500));
  v1::Job job = JobAt(3, 1);
  ASSERT_TRUE(cursor.Take(&job, 0));
  EXPECT_TRUE(job.has_settings());
}

TEST(WatchCursor, EndsWithTheJobAlsoIfItsEndIsKnown) {
  WatchCursor cursor(From(2, 5));
  v1::Job job = JobAt(2, 6, v1::JOB_STATE_FAILED);
  EXPECT_TRUE(cursor.Take(&job, 0));
  EXPECT_TRUE(cursor.ended());
  WatchCursor resumed(From(2, 6));
  job = JobAt(2, 6, v1::JOB_STATE_FAILED);
  EXPECT_FALSE(resumed.Take(&job, 0));
  EXPECT_TRUE(resumed.ended());
}

}  // namespace
}  // namespace tessera
