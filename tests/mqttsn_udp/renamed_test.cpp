// SPDX-License-Identifier: Apache-2.0
// A robot that the configuration renames, and whose firmware makes its topics from its client id.
#include <gtest/gtest.h>

#include "adapters/mqttsn_udp/clients/session_codec.hpp"
#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

/// The client id is "nrf-7", the robot's name is "tank".
struct RenamedRig : SnRig {
  explicit RenamedRig(Settings settings = {})
      : SnRig(std::move(settings), {{"tank", {}, "nrf-7"}}) {
    send(1, Connect{false, false, 1, 600, "nrf-7"});
    sent_to(1);
  }
};

TEST(SnGateway, PublishesARenamedRobotsTopicsUnderItsName) {
  RenamedRig rig;
  const auto id = rig.register_topic(1, "ntnu-slam/robot/nrf-7/update");
  rig.publish(1, id, 1, 7);
  ASSERT_EQ(rig.reports.size(), 1U);
  EXPECT_EQ(rig.reports[0].topic, "ntnu-slam/robot/tank/update");
  EXPECT_EQ(rig.reports[0].robot, "tank");
  EXPECT_EQ(rig.register_topic(1, "ntnu-slam/robot/tank/update"), id) << "both names are one topic";
  EXPECT_TRUE(rig.notices.empty());
}

TEST(SnGateway, GivesARenamedRobotItsCommandsUnderItsClientId) {
  RenamedRig rig;
  rig.subscribe(1, "ntnu-slam/server/nrf-7/#", 1);
  ASSERT_EQ(rig.subscribes.size(), 1U);
  EXPECT_EQ(rig.subscribes[0].filter, "ntnu-slam/server/tank/#");
  rig.broker("ntnu-slam/server/tank/cmd", "go", 1);
  EXPECT_EQ(rig.last_to(1), "REGISTER id=1 msg=1 topic=ntnu-slam/server/nrf-7/cmd");
  rig.send(1, Regack{1, 1, ReturnCode::accepted});
  rig.send(1, Puback{1, 2, ReturnCode::accepted});
  ASSERT_EQ(rig.outcomes.size(), 1U);
  EXPECT_EQ(rig.outcomes[0].result, CommandResult::delivered);
  EXPECT_EQ(rig.outcomes[0].robot, "tank");
  Unsubscribe unsubscribe;
  unsubscribe.topic_name = "ntnu-slam/server/nrf-7/#";
  rig.send(1, unsubscribe);
  EXPECT_EQ(rig.unsubscribes.size(), 1U);
}

TEST(SnGateway, SpeaksToARenamedRobotByItsNameWhenItUsesThat) {
  RenamedRig rig;
  rig.subscribe(1, "ntnu-slam/server/tank/+", 1);
  rig.broker("ntnu-slam/server/tank/cmd", "go", 1);
  EXPECT_EQ(rig.last_to(1), "REGISTER id=1 msg=1 topic=ntnu-slam/server/tank/cmd");
}

TEST(SnGateway, TranslatesNobodyElsesTopics) {
  RenamedRig rig;
  rig.subscribe(1, "ntnu-slam/server/nrf-7/+", 1);
  rig.subscribe(1, "ntnu-slam/robot/+/update", 1);
  rig.subscribe(1, "ntnu-slam/robot/nrf-70/update", 1);
  EXPECT_EQ(rig.subscribes.back().filter, "ntnu-slam/robot/nrf-70/update");
  rig.broker("ntnu-slam/robot/nrf-7x/update", "u", 1);
  EXPECT_EQ(rig.last_to(1), "REGISTER id=2 msg=1 topic=ntnu-slam/robot/nrf-7x/update");
  rig.connect(2, "r2");
  rig.send(2, Register{0, 1, "ntnu-slam/server/nrf-7/cmd"});
  EXPECT_EQ(rig.last_to(2), "REGACK id=0 msg=1 code=3") << "not its own";
}

TEST(SnGateway, TranslatesTheWillOfARenamedRobot) {
  SnRig rig({}, {{"tank", {}, "nrf-7"}});
  rig.send(1, Connect{true, true, 1, 60, "nrf-7"});
  rig.send(1, WillTopic{WireQos::one, false, "ntnu-slam/robot/nrf-7/gone"});
  rig.send(1, WillMsg{to_bytes("bye")});
  EXPECT_EQ(rig.last_to(1), "CONNACK code=0");
  rig.pass_s(100);
  ASSERT_EQ(rig.reports.size(), 1U);
  EXPECT_EQ(rig.reports[0].topic, "ntnu-slam/robot/tank/gone");
}

TEST(SnGateway, TranslatesPredefinedTopicsOfARenamedRobot) {
  Settings settings;
  settings.predefined_topics = {{7, "ntnu-slam/robot/nrf-7/update", "nrf-7"}};
  settings.allow_unconnected_publish = true;
  RenamedRig rig(settings);
  rig.send(1, Publish{false, WireQos::zero, false, TopicIdType::predefined, 7, 0, {}});
  rig.send(1, Publish{false, WireQos::minus_one, false, TopicIdType::predefined, 7, 0, {}});
  ASSERT_EQ(rig.reports.size(), 2U);
  for (const Report& report : rig.reports) EXPECT_EQ(report.topic, "ntnu-slam/robot/tank/update");
}

TEST(SnGateway, RemembersOverARestartHowARenamedRobotCallsItsTopics) {
  RenamedRig before;
  before.subscribe(1, "ntnu-slam/server/nrf-7/+", 1);
  const Bytes stored = encode_session(*before.gateway.snapshot("nrf-7", before.now));
  SnRig after({}, {{"tank", {}, "nrf-7"}});
  ASSERT_TRUE(after.gateway.restore(*decode_session(stored), after.now));
  after.broker("ntnu-slam/server/tank/cmd", "go", 1);
  EXPECT_EQ(after.last_to(1), "REGISTER id=1 msg=1 topic=ntnu-slam/server/nrf-7/cmd");
}

}  // namespace
}  // namespace slamgw::mqttsn
