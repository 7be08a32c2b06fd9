// SPDX-License-Identifier: Apache-2.0
// Answers over real UDP wait for a store whose writes the test ends.
#include <gtest/gtest.h>

#include <algorithm>
#include <boost/asio/post.hpp>
#include <iterator>
#include <thread>

#include "adapters/mqttsn_udp/io/session_keeper.hpp"
#include "tests/mqttsn_udp/io/udp_rig.hpp"

namespace slamgw::mqttsn {
namespace {

class ManualStore final : public SessionStore {
 public:
  std::vector<Session> load() override { return {}; }
  void save(std::vector<Change> changes) override {
    std::move(changes.begin(), changes.end(), std::back_inserter(writing));
  }
  bool is_busy() const override { return !writing.empty(); }
  void watch(std::function<void(bool)> on_written) override { on_written_ = std::move(on_written); }

  void finish(bool is_written) {
    if (is_written) writing.clear();
    if (on_written_) on_written_(is_written);
  }
  std::vector<Change> writing;

 private:
  std::function<void(bool)> on_written_;
};

class SavedAnswers : public testing::Test {
 protected:
  bool is_being_written(std::size_t sessions) {
    return test::eventually(rig.io, [&] { return store.writing.size() == sessions; });
  }
  static Settings settings() { return UdpRig::with({}, {"127.0.0.1:0"}); }

  ManualStore store;
  UdpRig rig = UdpRig::as_is(settings(), &store);
  UdpClient client{rig, "127.0.0.1"};
};

TEST_F(SavedAnswers, LeaveWhenTheWriteIsDone) {
  client.send(Connect{false, true, 1, 60, "r1"});
  ASSERT_TRUE(is_being_written(1));
  EXPECT_EQ(store.writing[0].id, "r1");
  EXPECT_FALSE(client.has_answer());
  store.finish(true);
  EXPECT_EQ(client.receive(), "CONNACK code=0");
}

TEST_F(SavedAnswers, ShareTheNextWriteWhileOneIsUnderWay) {
  client.send(Connect{false, true, 1, 60, "r1"});
  ASSERT_TRUE(is_being_written(1));
  UdpClient second(rig, "127.0.0.1");
  UdpClient third(rig, "127.0.0.1");
  second.send(Connect{false, true, 1, 60, "r2"});
  third.send(Connect{false, true, 1, 60, "r3"});
  ASSERT_TRUE(test::eventually(rig.io, [&] { return rig.adapter.presence_of("r3").has_value(); }));
  store.finish(true);
  ASSERT_TRUE(is_being_written(2));
  store.finish(true);
  EXPECT_EQ(second.receive(), "CONNACK code=0");
  EXPECT_EQ(third.receive(), "CONNACK code=0");
}

TEST_F(SavedAnswers, LeaveUnsavedWhenTheDiskHangs) {
  client.send(Connect{false, true, 1, 60, "r1"});
  ASSERT_TRUE(is_being_written(1));
  EXPECT_EQ(client.receive(), "CONNACK code=0");
  EXPECT_TRUE(store.is_busy());
}

TEST_F(SavedAnswers, LeaveUnsavedAtOnceWhenTheStoreFails) {
  client.send(Connect{false, true, 1, 60, "r1"});
  ASSERT_TRUE(is_being_written(1));
  store.finish(false);
  EXPECT_EQ(client.receive(), "CONNACK code=0");
  client.send(Register{0, 1, "ntnu-slam/robot/r1/adv"});
  EXPECT_TRUE(client.receive().starts_with("REGACK"));
}

/// The loop is blocked until the first write has taken too long. That write ends, and the next one
/// begins, before the handler of the first timer runs.
TEST_F(SavedAnswers, WaitInFullForTheNextWriteAfterALateTimer) {
  client.send(Connect{false, true, 1, 60, "r1"});
  ASSERT_TRUE(is_being_written(1));
  UdpClient second(rig, "127.0.0.1");
  second.send(Connect{false, true, 1, 60, "r2"});
  ASSERT_TRUE(test::eventually(rig.io, [&] { return rig.adapter.presence_of("r2").has_value(); }));
  TimePoint begun{};
  boost::asio::post(rig.io, [&] {
    std::this_thread::sleep_for(SessionKeeper::write_patience);
    boost::asio::post(rig.io, [&] {
      begun = std::chrono::steady_clock::now();
      store.finish(true);
    });
  });
  ASSERT_TRUE(test::eventually(rig.io, [&] { return second.has_answer(); }));
  EXPECT_GE(std::chrono::steady_clock::now() - begun, SessionKeeper::write_patience);
  EXPECT_EQ(client.receive(), "CONNACK code=0");
}

}  // namespace
}  // namespace slamgw::mqttsn
