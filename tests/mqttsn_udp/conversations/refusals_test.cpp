// SPDX-License-Identifier: Apache-2.0
// Refusals are counted, and reported to the operator once for each client.
#include <gtest/gtest.h>

#include "adapters/mqttsn_udp/limits.hpp"
#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

void connect_with_will(SnRig& rig, unsigned n, const std::string& id, const std::string& topic) {
  rig.send(n, Connect{true, true, 1, 60, id});
  rig.send(n, WillTopic{WireQos::zero, false, topic});
}

TEST(SnGateway, ReportsARefusedWillOnceForEachClient) {
  SnRig rig;
  for (int i = 0; i < 3; ++i) {
    connect_with_will(rig, 1, "r1", "elsewhere/r1");
    connect_with_will(rig, 2, "r2", "elsewhere/r2");
  }
  ASSERT_EQ(rig.notices.size(), 2U);
  EXPECT_NE(rig.notices[0].text.find("r1 may not have a will on 'elsewhere/r1'"),
            std::string::npos);
  EXPECT_NE(rig.notices[1].text.find("r2 may not have a will on 'elsewhere/r2'"),
            std::string::npos);
  EXPECT_EQ(rig.counter("wills_refused"), 6U);
  EXPECT_EQ(rig.counter("connects_refused"), 6U);
  connect_with_will(rig, 3, "r3", "a/+");
  EXPECT_EQ(rig.notices.size(), 3U) << "not a valid topic name";
}

TEST(SnGateway, ReportsAProvenRobotsRefusalDuringAFloodOfOthers) {
  SnRig rig;
  rig.prove(1, "r1");
  for (unsigned i = 0; i < 3 * limits::refusal_lines_burst; ++i)
    rig.send(2, Connect{false, true, 2, 60, "stranger-" + std::to_string(i)});
  const std::size_t before = rig.notices.size();
  EXPECT_EQ(before, limits::refusal_lines_burst);
  EXPECT_FALSE(rig.notices.back().is_proven);
  rig.subscribe(1, "elsewhere/#");
  ASSERT_EQ(rig.notices.size(), before + 1);
  EXPECT_TRUE(rig.notices.back().is_proven);
  rig.pass_s(1);
  rig.send(2, Connect{false, true, 2, 60, "another"});
  EXPECT_NE(rig.notices.back().text.find("(200 refusals since the last line)"), std::string::npos)
      << rig.notices.back().text;
}

TEST(SnGateway, ReportsARefusedClientIdOnce) {
  SnRig rig({}, {{"tank", {}, "tank-client"}});
  for (int i = 0; i < 3; ++i) {
    rig.send(1, Connect{false, true, 1, 60, "no/level"});
    rig.send(2, Connect{false, true, 1, 60, "tank"});
    rig.send(3, Connect{false, true, 2, 60, "r3"});
  }
  ASSERT_EQ(rig.notices.size(), 3U);
  EXPECT_NE(
      rig.notices[0].text.find("[fd00::1]:47193 may not connect as 'no/level' (CONNACK 0x03)"),
      std::string::npos);
  EXPECT_NE(rig.notices[1].text.find("another robot has this name"), std::string::npos);
  EXPECT_NE(rig.notices[2].text.find("its protocol is not MQTT-SN 1.2"), std::string::npos);
  EXPECT_EQ(rig.counter("connects_refused"), 9U);
}

TEST(SnGateway, ReportsAnUnknownTopicIdOnceForEachClient) {
  ConnectedRig rig;
  for (std::uint16_t msg_id = 1; msg_id <= 3; ++msg_id) {
    rig.publish(1, 9, 1, msg_id);
    rig.send(1, Publish{false, WireQos::one, false, TopicIdType::predefined, 8, msg_id, {}});
  }
  ASSERT_EQ(rig.notices.size(), 2U);
  EXPECT_EQ(rig.notices[0].robot, "r1");
  EXPECT_EQ(rig.notices[0].text, "a message of r1 is refused: topic id 9 is not registered");
  EXPECT_EQ(rig.notices[1].text,
            "a message of r1 is refused: predefined topic id 8 is not in "
            "mqttsn.predefined_topics");
  EXPECT_EQ(rig.counter("unknown_topic_ids"), 6U);
}

TEST(SnGateway, ReportsARefusedQosMinusOneOnceForEachClient) {
  SnRig rig;
  const Publish publish{false, WireQos::minus_one, false, TopicIdType::short_name, 0x6162, 0, {}};
  for (int i = 0; i < 3; ++i) {
    rig.send(1, publish);
    rig.send(2, publish);
  }
  ASSERT_EQ(rig.notices.size(), 2U);
  EXPECT_NE(rig.notices[0].text.find("QoS -1 from [fd00::1]:47193"), std::string::npos);
  EXPECT_NE(rig.notices[0].text.find("mqttsn.allow_unconnected_publish"), std::string::npos);
  EXPECT_EQ(rig.counter("unconnected_refused"), 6U);
}

TEST(SnGateway, ReportsOnceThatAllPlacesAreTaken) {
  Settings settings;
  settings.max_clients = 1;
  ConnectedRig rig(settings);
  for (unsigned n = 2; n < 10; ++n)
    rig.send(n, Connect{false, true, 1, 60, "x" + std::to_string(n)});
  ASSERT_EQ(rig.notices.size(), 1U);
  EXPECT_NE(rig.notices[0].text.find("all 1 places (mqttsn.max_clients)"), std::string::npos);
}

TEST(SnGateway, BoundsTheNumberOfNoticesAboutRefusals) {
  SnRig rig;
  for (unsigned i = 0; i < 20000; ++i)
    rig.send(i % 1000, Connect{false, true, 1, 60, "no/" + std::to_string(i)});
  EXPECT_EQ(rig.notices.size(), limits::refusal_lines_burst);
  EXPECT_EQ(rig.counter("connects_refused"), 20000U);
}

TEST(SnGateway, ReportsWhyCommandsEndWhenTheRobotDisconnects) {
  ConnectedRig rig;
  rig.subscribe(1, "ntnu-slam/server/r1/cmd", 1);
  for (int i = 0; i < 2; ++i) rig.broker("ntnu-slam/server/r1/cmd", "go", 1);
  rig.send(1, Disconnect{});
  ASSERT_EQ(rig.outcomes.size(), 2U);
  EXPECT_EQ(rig.outcomes[0].result, CommandResult::timeout) << "it was already sent";
  EXPECT_EQ(rig.outcomes[1].result, CommandResult::refused);
  for (const CommandOutcome& outcome : rig.outcomes)
    EXPECT_EQ(outcome.why, "the robot has disconnected");
}

/// simon622's client forgets its topic ids while it sleeps, and answers in this way.
TEST(SnGateway, RegistersAgainForASleeperThatAnswersNotSupportedWithTopicId0) {
  ConnectedRig rig;
  rig.subscribe(1, "a/x", 1);
  rig.sleep(1, 100);
  rig.broker("a/x", "1", 1);
  rig.broker("a/x", "2", 1);
  rig.send(1, Pingreq{"r1"});
  rig.sent_to(1);
  rig.send(1, Puback{0, 1, ReturnCode::not_supported});
  EXPECT_EQ(rig.sent_to(1), Lines{"REGISTER id=1 msg=2 topic=a/x"});
  rig.send(1, Regack{1, 2, ReturnCode::accepted});
  EXPECT_EQ(rig.sent_to(1), Lines{"PUBLISH dup=0 qos=1 retain=0 normal id=1 msg=3 data=31"});
  rig.send(1, Puback{1, 3, ReturnCode::accepted});
  EXPECT_EQ(rig.sent_to(1), Lines{"PUBLISH dup=0 qos=1 retain=0 normal id=1 msg=4 data=32"});
  rig.send(1, Puback{1, 4, ReturnCode::not_supported});
  EXPECT_EQ(rig.sent_to(1), Lines{"PINGRESP"}) << "with a topic id, code 3 is a refusal";
}

/// simon622's client disconnects at a PUBLISH of QoS 2 with a topic id that it has forgotten.
TEST(SnGateway, RegistersAllTopicsAgainForASleeperThatForgetsThem) {
  ConnectedRig rig;
  rig.subscribe(1, "a/x", 1);
  rig.subscribe(1, "a/y", 2);
  rig.sleep(1, 100);
  rig.broker("a/x", "1", 1);
  rig.broker("a/y", "2", 2);
  rig.send(1, Pingreq{"r1"});
  rig.send(1, Puback{0, 1, ReturnCode::not_supported});
  rig.send(1, Regack{1, 2, ReturnCode::accepted});
  rig.sent_to(1);
  rig.send(1, Puback{1, 3, ReturnCode::accepted});
  EXPECT_EQ(rig.sent_to(1), Lines{"REGISTER id=2 msg=4 topic=a/y"});
  rig.send(1, Regack{2, 4, ReturnCode::accepted});
  EXPECT_EQ(rig.sent_to(1), Lines{"PUBLISH dup=0 qos=2 retain=0 normal id=2 msg=5 data=32"});
  rig.send(1, Pubrec{5});
  rig.send(1, Pubcomp{5});
  EXPECT_EQ(rig.last_to(1), "PINGRESP");

  rig.broker("a/y", "3", 2);
  rig.send(1, Pingreq{"r1"});
  EXPECT_EQ(rig.last_to(1), "PUBLISH dup=0 qos=2 retain=0 normal id=2 msg=6 data=33")
      << "it remembers topics that were registered since it fell asleep";
  rig.send(1, Pubrec{6});
  rig.send(1, Pubcomp{6});

  rig.sleep(1, 100);
  rig.broker("a/y", "4", 2);
  rig.send(1, Pingreq{"r1"});
  EXPECT_EQ(rig.last_to(1), "REGISTER id=2 msg=7 topic=a/y") << "it has fallen asleep again";
}

/// The client gets PINGRESP after a message of QoS 0, and refuses the message when asleep again.
TEST(SnGateway, RegistersAllTopicsAgainForASleeperThatRefusesQos0) {
  ConnectedRig rig;
  rig.subscribe(1, "a/x", 0);
  rig.subscribe(1, "a/y", 2);
  rig.sleep(1, 100);
  rig.broker("a/x", "1", 0);
  rig.send(1, Pingreq{"r1"});
  rig.sent_to(1);
  rig.send(1, Puback{0, 0, ReturnCode::not_supported});
  EXPECT_TRUE(rig.is_silent(1));
  rig.broker("a/y", "2", 2);
  rig.send(1, Pingreq{"r1"});
  EXPECT_EQ(rig.sent_to(1), Lines{"REGISTER id=1 msg=1 topic=a/x"});
  rig.send(1, Regack{1, 1, ReturnCode::accepted});
  EXPECT_EQ(rig.sent_to(1), (Lines{"PUBLISH dup=0 qos=0 retain=0 normal id=1 msg=0 data=31",
                                   "REGISTER id=2 msg=2 topic=a/y"}));
}

/// RIOT's emcute refuses every repetition with DUP.
TEST(SnGateway, RepeatsWithoutDupForAClientThatRefusesIt) {
  ConnectedRig rig;
  rig.subscribe(1, "a/x", 1);
  rig.broker("a/x", "1", 1);
  rig.pass(RetransmissionTimeout::initial);
  EXPECT_EQ(rig.last_to(1), "PUBLISH dup=1 qos=1 retain=0 normal id=1 msg=1 data=31");
  rig.send(1, Puback{1, 1, ReturnCode::not_supported});
  EXPECT_EQ(rig.last_to(1), "PUBLISH dup=0 qos=1 retain=0 normal id=1 msg=1 data=31");
  rig.send(1, Puback{1, 1, ReturnCode::accepted});
  rig.broker("a/x", "2", 1);
  rig.pass_s(10);
  for (const std::string& line : rig.sent_to(1))
    EXPECT_EQ(line, "PUBLISH dup=0 qos=1 retain=0 normal id=1 msg=2 data=32");
  rig.send(1, Puback{1, 2, ReturnCode::not_supported});
  EXPECT_EQ(rig.gateway.queued_for("r1"), 0U) << "without DUP, code 3 is a refusal";
}

TEST(SnGateway, RegistersATopicAgainOnlyOnce) {
  ConnectedRig rig;
  rig.subscribe(1, "a/x", 1);
  rig.broker("a/x", "1", 1);
  rig.send(1, Puback{0, 1, ReturnCode::not_supported});
  rig.send(1, Regack{1, 2, ReturnCode::accepted});
  rig.sent_to(1);
  rig.send(1, Puback{0, 3, ReturnCode::not_supported});
  rig.pass_s(10);
  EXPECT_TRUE(rig.is_silent(1));
  EXPECT_EQ(rig.gateway.queued_for("r1"), 0U);
}

TEST(SnGateway, ServesARobotWithAnAddressOnlyFromThatAddress) {
  const RobotName tank{"tank", {}, "tank-client", {}, "fd00::1"};
  Settings settings;
  settings.allow_unconnected_publish = true;
  settings.predefined_topics = {{1, "ntnu-slam/robot/tank/adv", {}}};
  SnRig rig(settings, {tank});
  for (int i = 0; i < 3; ++i) rig.send(2, Connect{false, true, 1, 60, "tank-client"});
  EXPECT_EQ(rig.sent_to(2), Lines(3, "CONNACK code=3"));
  EXPECT_EQ(rig.counter("connects_refused"), 3U);
  ASSERT_EQ(rig.notices.size(), 1U);
  EXPECT_NE(rig.notices[0].text.find("another address for it (robots[].address)"),
            std::string::npos);
  rig.connect(1, "tank-client", false);
  connect_with_will(rig, 2, "tank-client", "ntnu-slam/robot/tank/lost");
  EXPECT_EQ(rig.sent_to(2).front(), "CONNACK code=3");
  for (const unsigned n : {1U, 2U})
    rig.send(n, Publish{false, WireQos::minus_one, false, TopicIdType::predefined, 1, 0, {}});
  EXPECT_EQ(rig.reports.size(), 1U) << "only QoS -1 from the robot's address";

  rig.sleep(1);
  rig.sent_to(2);
  rig.send(2, Pingreq{"tank-client"});
  EXPECT_EQ(rig.last_to(2), "DISCONNECT plain");
  const auto kept = rig.gateway.snapshot("tank-client", rig.now);
  SnRig moved({}, {{"tank", {}, "tank-client", {}, "fd00::2"}});
  EXPECT_FALSE(moved.gateway.restore(*kept, moved.now));
  rig.rename({{"tank", {}, "tank-client", {}, "fd00::/64"}});
  EXPECT_TRUE(rig.gateway.snapshot("tank-client", rig.now)) << "its address still matches";
  rig.rename({{"tank", {}, "tank-client", {}, "fd00::2"}});
  EXPECT_FALSE(rig.gateway.snapshot("tank-client", rig.now));
}

}  // namespace
}  // namespace slamgw::mqttsn
