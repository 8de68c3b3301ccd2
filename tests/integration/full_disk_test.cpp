// A server whose file system is really full: a tmpfs of a few megabytes, which needs root.
#include <gtest/gtest.h>
#include <sched.h>
#include <sys/mount.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <string>

#include "tests/integration/farm.h"

namespace tessera {
namespace {

constexpr int64_t kSpp = 64;
constexpr char kReason[] = "disk is full";

class FullDisk : public testing::Test {
 protected:
  // In a mount namespace of the test's own: the mount goes with the process, whatever happens.
  void SetUp() override {
    dir_ = directory_.path() + "/small";
    std::filesystem::create_directories(dir_);
    if (unshare(CLONE_NEWNS) != 0 ||
        mount("none", "/", nullptr, MS_REC | MS_PRIVATE, nullptr) != 0 ||
        mount("tmpfs", dir_.c_str(), "tmpfs", 0, "size=16m") != 0) {
      GTEST_SKIP() << "cannot mount a file system: " << std::strerror(errno);
    }
    is_mounted_ = true;
    // The log has room, whatever the data have.
    std::filesystem::create_symlink(directory_.path() + "/server.log", dir_ + "/server.log");
    server_ = std::make_unique<ServerProcess>(dir_);
    client_ = std::make_unique<RpcClient>(server_->Channel());
  }
  void TearDown() override {
    server_.reset();
    if (is_mounted_) umount2(dir_.c_str(), MNT_DETACH);
  }

  void FillDisk() {
    std::ofstream ballast(dir_ + "/ballast", std::ios::binary);
    const std::string block(4096, 'b');
    while (ballast.write(block.data(), 4096).flush()) {
    }
    ASSERT_EQ(std::filesystem::space(dir_).available, 0u);
  }
  void MakeRoom() { std::filesystem::remove(dir_ + "/ballast"); }

  TemporaryDirectory directory_;
  std::string dir_;
  bool is_mounted_ = false;
  std::unique_ptr<ServerProcess> server_;
  std::unique_ptr<RpcClient> client_;
};

TEST_F(FullDisk, JobsSayWhyAndGoOnByThemselvesToTheSameBits) {
  const v1::AssetRef scene = client_->UploadScene("cornell");
  const std::string begun = client_->MustCreate(SmallJob(scene, 1 << 20, 16)).name();
  {
    const auto worker = StartWorkerProcess(server_->address(), directory_.path() + "/worker.log");
    client_->WatchUntil(begun, [](const v1::Job& j) { return j.progress().samples() > 0; });
  }
  const std::string kept = client_->MustCreate(SmallJob(scene, kSpp, 16)).name();
  FillDisk();
  v1::PauseJobRequest pause;
  pause.set_name(begun);
  grpc::ClientContext context;
  v1::Job ignored;
  (void)client_->jobs().PauseJob(&context, pause, &ignored);  // its film finds no room
  const int64_t samples = client_->Get(begun).progress().samples();
  const v1::Job waiting = client_->WatchUntil(kept, [](const v1::Job& j) {
    return j.waiting().find(kReason) != std::string::npos;
  });
  ASSERT_NE(waiting.waiting().find(kReason), std::string::npos) << waiting.ShortDebugString();

  // Nothing new is taken meanwhile.
  v1::WriteAssetResponse response;
  grpc::ClientContext upload_context;
  const auto writer = client_->assets().WriteAsset(&upload_context, &response);
  v1::WriteAssetRequest request;
  request.mutable_asset()->set_sha256(std::string(32, 'z'));
  request.mutable_asset()->set_size_bytes(100000);
  request.set_chunk(std::string(99999, 'c'));
  writer->Write(request);
  writer->WritesDone();
  const grpc::Status refused = writer->Finish();
  EXPECT_EQ(refused.error_code(), grpc::StatusCode::RESOURCE_EXHAUSTED) << refused.error_message();
  EXPECT_NE(refused.error_message().find("free some space"), std::string::npos);

  MakeRoom();
  const auto worker = StartWorkerProcess(server_->address(), directory_.path() + "/worker2.log");
  const v1::Job done = client_->Watch(kept);
  EXPECT_EQ(done.state(), v1::JOB_STATE_DONE) << done.error();
  const v1::Job paused = client_->Get(begun);
  EXPECT_EQ(paused.state(), v1::JOB_STATE_PAUSED);
  EXPECT_GE(paused.progress().samples(), samples);
  const v1::Job undisturbed =
      client_->Watch(client_->MustCreate(SmallJob(scene, kSpp, 16)).name());
  EXPECT_EQ(HexDigest(undisturbed), HexDigest(done));
}

// A job that was cancelled is shown as FINISHING, with the reason, as long as the disk has no room
// for its samples and its end; then as cancelled, also by a server that was killed after that.
TEST_F(FullDisk, AnEndIsShownOnceThereIsRoomForIt) {
  const v1::AssetRef scene = client_->UploadScene("cornell");
  const std::string name = client_->MustCreate(SmallJob(scene, 1 << 20, 16)).name();
  const auto worker = StartWorkerProcess(server_->address(), directory_.path() + "/worker.log");
  client_->WatchUntil(name, [](const v1::Job& j) { return j.progress().samples() > 0; });
  FillDisk();
  client_->Cancel(name);
  const v1::Job withheld = client_->WatchUntil(name, [](const v1::Job& j) {
    return j.state() == v1::JOB_STATE_FINISHING &&
           j.waiting().find("end cannot be written") != std::string::npos;
  });
  EXPECT_EQ(withheld.state(), v1::JOB_STATE_FINISHING) << withheld.ShortDebugString();
  EXPECT_NE(withheld.waiting().find("free some space"), std::string::npos) << withheld.waiting();
  EXPECT_EQ(client_->Get(name).state(), v1::JOB_STATE_FINISHING);

  MakeRoom();
  const v1::Job ended = client_->Watch(name);
  EXPECT_EQ(ended.state(), v1::JOB_STATE_CANCELLED) << ended.ShortDebugString();
  EXPECT_GT(ended.progress().samples(), 0);
  server_->process().Signal(SIGKILL);
  server_ = std::make_unique<ServerProcess>(dir_);
  client_ = std::make_unique<RpcClient>(server_->Channel());
  const v1::Job restored = client_->Get(name);
  EXPECT_EQ(restored.state(), v1::JOB_STATE_CANCELLED) << restored.ShortDebugString();
  EXPECT_EQ(restored.progress().samples(), ended.progress().samples());
  EXPECT_EQ(HexDigest(restored), HexDigest(ended));
}

}  // namespace
}  // namespace tessera
