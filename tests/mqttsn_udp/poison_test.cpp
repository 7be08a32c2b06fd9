// SPDX-License-Identifier: Apache-2.0
// Text for which a broker closes its connection (is_mqtt_text). The gateway refuses it from clients
// with return code 3 (not supported), and drops it from stored sessions.
#include <gtest/gtest.h>

#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

class Poison : public testing::TestWithParam<std::string> {
 protected:
  Poison() : rig({}, {}, {"#"}, {"#"}) {}

  void expect_harmless() {
    rig.pass_s(1000);  // a will that was accepted would be published
    EXPECT_TRUE(rig.reports.empty());
    EXPECT_TRUE(rig.subscribes.empty());
    for (const PresenceChange& change : rig.presence) EXPECT_EQ(change.robot, "r1");
  }

  const std::string text = "a" + GetParam();
  SnRig rig;
};

TEST_P(Poison, R31_IsRefusedAsClientId) {
  rig.send(1, Connect{false, true, 1, 60, text});
  EXPECT_EQ(rig.last_to(1), "CONNACK code=3");
  rig.send(1, Connect{true, true, 1, 60, text});
  EXPECT_EQ(rig.last_to(1), "CONNACK code=3");
  expect_harmless();
}

TEST_P(Poison, R57_IsRefusedAsTopic) {
  rig.connect(1, "r1");
  for (const std::string& topic : {text, "ntnu-slam/robot/r1/" + text}) {
    rig.send(1, Register{0, 7, topic});
    EXPECT_EQ(rig.last_to(1), "REGACK id=0 msg=7 code=3");
    rig.send(1, Subscribe{false, WireQos::one, TopicIdType::normal, 8, topic, 0});
    EXPECT_EQ(rig.last_to(1), "SUBACK qos=0 id=0 msg=8 code=3");
    rig.send(1, Subscribe{false, WireQos::one, TopicIdType::normal, 9, topic + "/+", 0});
    EXPECT_EQ(rig.last_to(1), "SUBACK qos=0 id=0 msg=9 code=3");
  }
  expect_harmless();
}

TEST_P(Poison, R55_IsRefusedAsWillTopic) {
  rig.send(1, Connect{true, true, 1, 60, "r1"});
  rig.send(1, WillTopic{WireQos::zero, false, text});
  EXPECT_EQ(rig.last_to(1), "CONNACK code=3");
  rig.connect(1, "r1");
  rig.send(1, WillTopicUpd{WireQos::zero, false, text});
  EXPECT_EQ(rig.last_to(1), "WILLTOPICRESP code=3");
  expect_harmless();
}

TEST_P(Poison, R47_IsDroppedFromStoredSessions) {
  rig.connect(1, "r1", false);
  const SessionSnapshot sane = *rig.gateway.snapshot("r1", rig.now);
  SessionSnapshot stored = sane;
  stored.will = Will{text, to_bytes("bye")};
  stored.topics = {{text, true}};
  stored.subscriptions = {{text, Qos::at_least_once}};
  SnRig after({}, {}, {"#"}, {"#"});
  EXPECT_TRUE(after.gateway.restore(stored, after.now));
  after.publish(1, 1, 1, 7);
  EXPECT_EQ(after.last_to(1), "PUBACK id=1 msg=7 code=3");
  after.pass_s(1000);
  EXPECT_TRUE(after.reports.empty());
  EXPECT_TRUE(after.subscribes.empty());

  stored = sane;
  stored.client_id = stored.robot = text;
  EXPECT_FALSE(after.gateway.restore(stored, after.now));
}

INSTANTIATE_TEST_SUITE_P(Text, Poison,
                         testing::Values("\x01", "\x7f", "\xc2\x80", "\xc2\x85", "\xc2\x9f",
                                         "\xef\xb7\x90", "\xef\xb7\xaf", "\xef\xbf\xbe",
                                         "\xef\xbf\xbf", "\xf0\x9f\xbf\xbf", "\xed\xa0\x80", "\xff",
                                         std::string("\0", 1)),
                         [](const auto& text) { return "x" + to_hex(as_bytes(text.param)); });

TEST(SnGateway, R57_RefusesTopicsWithMoreLevelsThanBrokersTake) {
  SnRig rig({}, {}, {"#"}, {"#"});
  rig.connect(1, "r1");
  std::string topic = "a";
  for (int i = 1; i < 200; ++i) topic += "/a";
  rig.send(1, Register{0, 7, topic});
  EXPECT_EQ(rig.last_to(1), "REGACK id=1 msg=7 code=0");
  rig.send(1, Register{0, 8, topic + "/a"});
  EXPECT_EQ(rig.last_to(1), "REGACK id=0 msg=8 code=3");
}

TEST(SnGateway, R62_RefusesInvalidTextInAShortTopicName) {
  SnRig rig({}, {}, {"#"}, {"#"});
  rig.connect(1, "r1");
  rig.send(1, Publish{false, WireQos::one, false, TopicIdType::short_name, 0xc285, 7, {}});
  EXPECT_EQ(rig.last_to(1), "PUBACK id=49797 msg=7 code=3");
  rig.send(1, Subscribe{false, WireQos::one, TopicIdType::short_name, 8, "", 0xc285});
  EXPECT_EQ(rig.last_to(1), "SUBACK qos=0 id=0 msg=8 code=3");
  EXPECT_TRUE(rig.reports.empty());
  EXPECT_TRUE(rig.subscribes.empty());
}

}  // namespace
}  // namespace slamgw::mqttsn
