// SPDX-License-Identifier: Apache-2.0
// Clean session and will (R42-R56).
#include <gtest/gtest.h>

#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

const std::string first_will = "ntnu-slam/robot/r1/first";
const std::string second_will = "ntnu-slam/robot/r1/second";

/// Connects with this will. An empty topic deletes the will.
void connect_with(SnRig& rig, const std::string& topic, bool clean, WireQos qos = WireQos::one,
                  bool retain = true) {
  rig.send(1, Connect{true, clean, 1, 60, "r1"});
  rig.send(1, WillTopic{qos, retain, topic});
  if (!topic.empty()) rig.send(1, WillMsg{to_bytes("bye")});
  EXPECT_EQ(rig.last_to(1), "CONNACK code=0");
}

/// Connects a client with the first will and a subscription, and disconnects it.
SnRig& stored(SnRig& rig) {
  connect_with(rig, first_will, false);
  rig.subscribe(1, "a/x");
  rig.send(1, Disconnect{});
  rig.sent_to(1);
  return rig;
}

bool has_subscription(SnRig& rig) {
  rig.sent_to(1);
  rig.broker("a/x");
  return !rig.is_silent(1);
}

/// Returns the will that is published when the client falls silent.
std::string will_of(SnRig& rig) {
  rig.reports.clear();
  rig.pass_s(200);
  if (rig.reports.empty()) return "none";
  EXPECT_EQ(rig.reports.size(), 1U);
  return rig.reports[0].topic;
}

TEST(SnGateway, R42_CleanWithWillDeletesAllAndAsksForANewWill) {
  SnRig rig;
  connect_with(stored(rig), second_will, true);
  EXPECT_FALSE(has_subscription(rig));
  EXPECT_EQ(will_of(rig), second_will);
}

TEST(SnGateway, R43_CleanWithoutWillDeletesAll) {
  SnRig rig;
  stored(rig).connect(1, "r1", true);
  EXPECT_FALSE(has_subscription(rig));
  EXPECT_EQ(will_of(rig), "none");
}

TEST(SnGateway, R44_NotCleanWithWillKeepsSubscriptionsAndReplacesTheWill) {
  SnRig rig;
  connect_with(stored(rig), second_will, false);
  EXPECT_TRUE(has_subscription(rig));
  EXPECT_EQ(will_of(rig), second_will);
}

TEST(SnGateway, R45_NotCleanWithoutWillKeepsAll) {
  SnRig rig;
  stored(rig).connect(1, "r1", false);
  EXPECT_TRUE(has_subscription(rig));
  EXPECT_EQ(will_of(rig), first_will);
}

TEST(SnGateway, R46_NotCleanWithAnEmptyWillTopicDeletesOnlyTheWill) {
  SnRig rig;
  connect_with(stored(rig), "", false);
  EXPECT_TRUE(has_subscription(rig));
  EXPECT_EQ(will_of(rig), "none");
}

TEST(SnGateway, R47_KeepsUndeliveredMessagesWhileDisconnectedOrLost) {
  SnRig rig;
  stored(rig);
  rig.broker("a/x", "kept", 1);
  rig.broker("a/x", "not kept", 0);
  EXPECT_TRUE(rig.is_silent(1));
  rig.send(1, Connect{false, false, 1, 60, "r1"});
  EXPECT_EQ(rig.sent_to(1), (Lines{"CONNACK code=0", "REGISTER id=1 msg=1 topic=a/x"}));
  rig.send(1, Regack{1, 1, ReturnCode::accepted});
  EXPECT_EQ(rig.sent_to(1), Lines{"PUBLISH dup=0 qos=1 retain=0 normal id=1 msg=2 data=6b657074"});
}

TEST(SnGateway, R48_RegistersAgainInAResumedSessionAndAcceptsOldIds) {
  ConnectedRig rig(false);
  const auto up = rig.register_topic(1, first_will);
  rig.subscribe(1, "a/x");
  rig.connect(2, "r1", false);
  rig.broker("a/x");
  EXPECT_EQ(rig.sent_to(2), Lines{"REGISTER id=2 msg=1 topic=a/x"});
  rig.publish(2, up, 0, 0);
  ASSERT_EQ(rig.reports.size(), 1U);
  EXPECT_EQ(rig.reports[0].topic, first_will);
}

TEST(SnGateway, R48_RegistersBeforeItRepeatsInFlightMessages) {
  ConnectedRig rig(false);
  rig.subscribe(1, "a/x", 2);
  rig.broker("a/x", "hi", 2);
  rig.connect(1, "r1", false);
  rig.send(1, Regack{1, 2, ReturnCode::accepted});
  EXPECT_EQ(rig.sent_to(1), Lines{"PUBLISH dup=1 qos=2 retain=0 normal id=1 msg=1 data=6869"})
      << "under its old MsgId, so that the robot recognizes it";
  rig.sleep(1);
  rig.send(1, Connect{false, false, 1, 60, "r1"});
  EXPECT_EQ(rig.sent_to(1), (Lines{"CONNACK code=0", "REGISTER id=1 msg=3 topic=a/x"}));
  rig.sleep(1);  // while it registers
  rig.send(1, Pingreq{"r1"});
  rig.sent_to(1);
  rig.send(1, Regack{1, 4, ReturnCode::accepted});
  EXPECT_EQ(rig.sent_to(1), Lines{"PUBLISH dup=1 qos=2 retain=0 normal id=1 msg=1 data=6869"});
}

TEST(SnGateway, R49_PlainDisconnectPublishesNoWill) {
  SnRig rig;
  connect_with(rig, first_will, true);
  rig.subscribe(1, "a/x");
  rig.send(1, Disconnect{});
  EXPECT_EQ(will_of(rig), "none");
  ASSERT_EQ(rig.unsubscribes.size(), 1U) << "the clean session has ended";
  EXPECT_EQ(rig.unsubscribes[0].filter, "a/x");
}

TEST(SnGateway, R50_PublishesTheWillExactlyOnceWhenLost) {
  SnRig rig;
  connect_with(rig, first_will, false, WireQos::two, true);
  rig.pass_s(10000);
  ASSERT_EQ(rig.reports.size(), 1U);
  EXPECT_EQ(rig.reports[0].topic, first_will);
  EXPECT_EQ(rig.reports[0].qos, Qos::exactly_once);
  EXPECT_TRUE(rig.reports[0].retain);
  EXPECT_TRUE(rig.reports[0].is_will);
  EXPECT_FALSE(rig.reports[0].receipt.is_owed());
}

TEST(SnGateway, R51_ArmsAStoredWillAgainOnConnect) {
  SnRig rig;
  connect_with(rig, first_will, false);
  EXPECT_EQ(will_of(rig), first_will);
  rig.connect(1, "r1", false);
  EXPECT_EQ(will_of(rig), first_will);
}

TEST(SnGateway, R52_ReplacesOrDeletesTheWillTopic) {
  SnRig rig;
  connect_with(rig, first_will, false);
  rig.send(1, WillTopicUpd{WireQos::zero, false, second_will});
  EXPECT_EQ(rig.last_to(1), "WILLTOPICRESP code=0");
  EXPECT_EQ(will_of(rig), second_will);
  EXPECT_EQ(rig.reports[0].qos, Qos::at_most_once);
  EXPECT_EQ(rig.reports[0].payload, to_bytes("bye"));
  rig.connect(1, "r1", false);
  rig.send_octets(1, hex("02 1a"));
  EXPECT_EQ(rig.last_to(1), "WILLTOPICRESP code=0");
  EXPECT_EQ(will_of(rig), "none");
}

TEST(SnGateway, R53_ReplacesTheWillMessage) {
  SnRig rig;
  connect_with(rig, first_will, false);
  rig.send(1, WillMsgUpd{to_bytes("gone")});
  EXPECT_EQ(rig.last_to(1), "WILLMSGRESP code=0");
  EXPECT_EQ(will_of(rig), first_will);
  EXPECT_EQ(rig.reports[0].payload, to_bytes("gone"));
}

TEST(SnGateway, R54_MakesAWillFromUpdatesAlone) {
  ConnectedRig rig;
  rig.send(1, WillMsgUpd{to_bytes("gone")});
  EXPECT_EQ(rig.last_to(1), "WILLMSGRESP code=3") << "the will has no topic yet";
  rig.send(1, WillTopicUpd{WireQos::one, false, first_will});
  EXPECT_EQ(rig.last_to(1), "WILLTOPICRESP code=0");
  rig.send(1, WillMsgUpd{to_bytes("gone")});
  EXPECT_EQ(rig.last_to(1), "WILLMSGRESP code=0");
  EXPECT_EQ(will_of(rig), first_will);
  EXPECT_EQ(rig.reports[0].payload, to_bytes("gone"));
}

TEST(SnGateway, R55_RefusesWillsThatTheClientMayNotPublish) {
  for (const std::string& topic :
       {std::string("ntnu-slam/robot/other/x"), std::string("ntnu-slam/robot/r1/#"),
        std::string("free/topic"), std::string("\xff")}) {
    SnRig rig;
    rig.send(1, Connect{true, true, 1, 60, "r1"});
    rig.send(1, WillTopic{WireQos::zero, false, topic});
    EXPECT_EQ(rig.last_to(1), "CONNACK code=3") << topic;
    EXPECT_EQ(rig.notices.size(), 1U) << "names the setting that would allow it";
    EXPECT_FALSE(rig.gateway.presence_of("r1"));
    connect_with(rig, first_will, true);
    rig.send(1, WillTopicUpd{WireQos::zero, false, topic});
    EXPECT_EQ(rig.last_to(1), "WILLTOPICRESP code=3");
    EXPECT_EQ(will_of(rig), first_will);
  }
}

TEST(SnGateway, R56_KeepsAWillForEachClient) {
  SnRig rig;
  connect_with(rig, first_will, true);
  rig.send(2, Connect{true, true, 1, 600, "r2"});
  rig.send(2, WillTopic{WireQos::zero, false, "ntnu-slam/robot/r2/gone"});
  rig.send(2, WillMsg{});
  EXPECT_EQ(will_of(rig), first_will) << "only the silent client's will";
}

}  // namespace
}  // namespace slamgw::mqttsn
