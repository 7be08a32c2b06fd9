// SPDX-License-Identifier: Apache-2.0
// When a robot's last will is published: another gateway may hold its session by now.
#include <gtest/gtest.h>

#include "tests/core/gateway_rig.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;

class WaitingWills : public test::SharedGatewayRig {
 protected:
  void will_of(const std::string& robot, const std::string& text = "gone") {
    say(Report{.mesh = Mesh::thread,
               .robot = robot,
               .topic = "ntnu-slam/robot/" + robot + "/will",
               .payload = to_bytes(text),
               .qos = Qos::at_least_once,
               .receipt = no_receipt,
               .is_will = true});
  }
  std::vector<std::string> published() {
    std::vector<std::string> texts;
    for (const PassUp& up : drain<PassUp>()) texts.emplace_back(as_text(up.event.payload));
    return texts;
  }
  const std::vector<std::string> none{};
};

/// The connection may be stalled, and the robot at another gateway.
TEST_F(WaitingWills, ArePublishedWhenTheSessionIsProvenToBeHeld) {
  broker_comes();
  held.insert("a");
  will_of("a");
  EXPECT_EQ(published(), none);
  gateway.on_session_proven("a", now);
  EXPECT_EQ(published(), std::vector<std::string>{"gone"});
  will_of("a");
  held.erase("a");
  broker_is(false);
  broker_comes();
  elsewhere.insert("a");
  pass(PresencePublisher::will_patience);
  EXPECT_EQ(published(), none) << "another gateway has taken the session";
}

TEST_F(WaitingWills, ArePublishedAtOnceByAGatewayThatIsAlone) {
  is_alone = true;
  will_of("a");
  EXPECT_EQ(published(), std::vector<std::string>{"gone"}) << "the outbox keeps it";
}

TEST_F(WaitingWills, WaitWhileTheHolderOfTheSessionIsUnknown) {
  broker_comes();
  will_of("a");
  EXPECT_EQ(published(), none);
  EXPECT_EQ(gateway.deadline(), now.mono + PresencePublisher::will_patience);
  pass(PresencePublisher::will_patience - 1ms);
  EXPECT_EQ(published(), none);
  pass(1ms);
  EXPECT_EQ(published(), std::vector<std::string>{"gone"});
  pass(1h);
  EXPECT_EQ(published(), none) << "once";
}

/// An earlier will, which is published already, does not shorten the wait of later ones.
TEST_F(WaitingWills, WaitEachForTheWholeTime) {
  broker_comes();
  will_of("a");
  pass(1s);
  session_comes("a");
  EXPECT_EQ(published(), std::vector<std::string>{"gone"});
  pass(PresencePublisher::will_patience - 1100ms);
  will_of("b", "b is gone");
  pass(100ms);
  EXPECT_EQ(published(), none) << "at the deadline of the first one";
  EXPECT_EQ(gateway.deadline(), now.mono + PresencePublisher::will_patience - 100ms);
  will_of("c", "c is gone");
  pass(PresencePublisher::will_patience - 100ms);
  EXPECT_EQ(published(), std::vector<std::string>{"b is gone"});
  pass(100ms);
  EXPECT_EQ(published(), std::vector<std::string>{"c is gone"});
}

TEST_F(WaitingWills, DelayNoOtherMessageOfTheRobot) {
  broker_comes();
  will_of("a");
  say(update_from("a", {1, 0, 2, 0}));
  EXPECT_EQ(published().size(), 1u);
}

TEST_F(WaitingWills, AreDroppedWhenAnotherGatewayShowsTheRobot) {
  broker_comes();
  will_of("a");
  will_of("b", "b is gone");
  elsewhere.insert("a");
  pass(PresencePublisher::will_patience);
  EXPECT_EQ(published(), std::vector<std::string>{"b is gone"});
  elsewhere.clear();
  pass(1h);
  EXPECT_EQ(published(), none);
}

TEST_F(WaitingWills, AreDroppedWhenTheRobotIsGivenUp) {
  broker_comes();
  will_of("a");
  gateway.presence().on_given_up("a");
  pass(1h);
  session_comes("a");
  EXPECT_EQ(published(), none);
}

TEST_F(WaitingWills, ArePublishedWhenTheSessionIsHeld) {
  broker_comes();
  will_of("a", "old");
  will_of("a", "new");
  will_of("b");
  session_comes("a");
  EXPECT_EQ(published(), std::vector<std::string>{"new"}) << "only the last one of the robot";
  pass(1h);
  EXPECT_EQ(published(), std::vector<std::string>{"gone"});
}

TEST_F(WaitingWills, WaitForTheBrokerAndThenForTheOtherGateways) {
  will_of("a");
  will_of("b", "b is gone");
  EXPECT_EQ(gateway.deadline(), std::nullopt);
  pass(1h);
  EXPECT_EQ(published(), none);
  broker_comes();
  pass(PresencePublisher::will_patience - PresencePublisher::settling - 1s);
  broker_is(false);
  pass(1h);
  EXPECT_EQ(published(), none);
  broker_comes();
  elsewhere.insert("a");
  pass(PresencePublisher::will_patience - PresencePublisher::settling - 1ms);
  EXPECT_EQ(published(), none) << "counted from the new connection";
  pass(1ms);
  EXPECT_EQ(published(), std::vector<std::string>{"b is gone"});
}

TEST_F(WaitingWills, AreDroppedWhenTheRobotIsHeardAgain) {
  broker_comes();
  for (const char* robot : {"a", "b"}) will_of(robot);
  say(update_from("a", {1, 0, 2, 0}));
  say(PresenceChange{Mesh::thread, "b", Presence::online, "x"});
  published();
  session_comes("a");
  session_comes("b");
  EXPECT_EQ(published(), none);
}

TEST_F(WaitingWills, AreBounded) {
  broker_comes();
  for (std::size_t i = 0; i < PresencePublisher::max_waiting_wills; ++i)
    will_of("r" + std::to_string(i));
  EXPECT_EQ(published(), none);
  will_of("one more");
  EXPECT_EQ(published(), std::vector<std::string>{"gone"});
  session_comes("r7");
  EXPECT_EQ(published().size(), 1u);
  will_of("another");
  EXPECT_EQ(published(), none) << "there is room again";
  pass(PresencePublisher::will_patience);
  EXPECT_EQ(published().size(), PresencePublisher::max_waiting_wills);
}

}  // namespace
}  // namespace slamgw
