// SPDX-License-Identifier: Apache-2.0
// Connecting (R23-R41).
#include <gtest/gtest.h>

#include <set>

#include "adapters/mqttsn_udp/limits.hpp"
#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

Connect with_will(const std::string& id, bool clean = true) { return {true, clean, 1, 60, id}; }
Connect plain(const std::string& id, bool clean = true) { return {false, clean, 1, 60, id}; }

TEST(SnGateway, R23_ConnectsWithoutAWillAtOnce) {
  SnRig rig;
  rig.send(1, plain("r1"));
  EXPECT_EQ(rig.sent_to(1), Lines{"CONNACK code=0"});
  EXPECT_EQ(rig.gateway.presence_of("r1"), Presence::online);
  rig.pass_s(89);
  EXPECT_EQ(rig.gateway.presence_of("r1"), Presence::online);
  rig.pass_s(2);
  EXPECT_EQ(rig.gateway.presence_of("r1"), Presence::offline);
}

TEST(SnGateway, R24_AsksForTheWillBeforeConnack) {
  SnRig rig;
  rig.send(1, with_will("r1"));
  EXPECT_EQ(rig.sent_to(1), Lines{"WILLTOPICREQ"});
  rig.send(1, WillTopic{WireQos::one, true, own_topic});
  EXPECT_EQ(rig.sent_to(1), Lines{"WILLMSGREQ"});
  EXPECT_FALSE(rig.gateway.presence_of("r1"));
  rig.send(1, WillMsg{to_bytes("bye")});
  EXPECT_EQ(rig.sent_to(1), Lines{"CONNACK code=0"});
}

TEST(SnGateway, R25_ConnectsAtOnceOnAnEmptyWillTopic) {
  SnRig rig;
  rig.send(1, with_will("r1"));
  rig.send_octets(1, hex("02 07"));
  EXPECT_EQ(rig.last_to(1), "CONNACK code=0");
  rig.pass_s(200);
  EXPECT_TRUE(rig.reports.empty()) << "without a will";
}

TEST(SnGateway, R26_TakesAnEmptyWillMessage) {
  SnRig rig;
  rig.send(1, with_will("r1"));
  rig.send(1, WillTopic{WireQos::zero, false, own_topic});
  rig.send_octets(1, hex("02 09"));
  EXPECT_EQ(rig.last_to(1), "CONNACK code=0");
  rig.pass_s(200);
  ASSERT_EQ(rig.reports.size(), 1U);
  EXPECT_TRUE(rig.reports[0].payload.empty());
}

TEST(SnGateway, R27_GivesUpAnUnfinishedHandshakeQuietly) {
  ConnectedRig rig(false, 3600);
  rig.send(2, with_will("r1"));
  rig.pass_s(100);
  EXPECT_EQ(rig.sent_to(2), Lines(4, "WILLTOPICREQ"));
  rig.send(1, Pingreq{});
  EXPECT_EQ(rig.last_to(1), "PINGRESP") << "the session is unchanged";
}

TEST(SnGateway, R28_RestartsTheHandshakeOnARepeatedConnect) {
  SnRig rig;
  rig.send(1, with_will("r1"));
  rig.send(1, WillTopic{WireQos::zero, false, own_topic});
  rig.send(1, WillTopic{WireQos::zero, false, own_topic});
  EXPECT_EQ(rig.sent_to(1), (Lines{"WILLTOPICREQ", "WILLMSGREQ", "WILLMSGREQ"}));
  rig.send(1, with_will("r1"));
  EXPECT_EQ(rig.last_to(1), "WILLTOPICREQ");
  rig.send(1, WillTopic{WireQos::zero, false, own_topic});
  rig.send(1, WillMsg{});
  EXPECT_EQ(rig.last_to(1), "CONNACK code=0");
}

TEST(SnGateway, R29_EndsTheHandshakeOnAnyOtherMessage) {
  Subscribe subscribe;
  subscribe.topic_name = "a/x";
  for (const Packet& packet : {Packet{Register{0, 1, own_topic}}, Packet{Publish{}},
                               Packet{subscribe}, Packet{WillMsg{}}, Packet{Disconnect{}}}) {
    SnRig rig;
    rig.send(1, with_will("r1"));
    rig.sent_to(1);
    rig.send(1, packet);
    EXPECT_EQ(rig.sent_to(1), Lines{"DISCONNECT plain"}) << describe(packet);
    rig.send(1, WillTopic{WireQos::zero, false, own_topic});
    EXPECT_TRUE(rig.is_silent(1)) << "the handshake has ended";
    rig.pass_s(60);
    EXPECT_TRUE(rig.is_silent(1));
  }
}

TEST(SnGateway, R30_RefusesAnotherProtocol) {
  ConnectedRig rig(false);
  rig.send(2, Connect{false, true, 2, 60, "r1"});
  EXPECT_EQ(rig.last_to(2), "CONNACK code=3");
  rig.send(1, Pingreq{});
  EXPECT_EQ(rig.last_to(1), "PINGRESP");
}

TEST(SnGateway, R31_TakesLongClientIdsAndRefusesEmptyOnes) {
  SnRig rig;
  rig.send_octets(1, hex("06 04 04 01 00 3c"));
  EXPECT_EQ(rig.last_to(1), "CONNACK code=3");
  rig.send(1, plain(std::string(64, 'x')));
  EXPECT_EQ(rig.last_to(1), "CONNACK code=0");
  rig.send(2, plain(std::string(65, 'x')));
  EXPECT_EQ(rig.last_to(2), "CONNACK code=3");
}

TEST(SnGateway, R32_RefusesClientIdsThatAreNotATopicLevel) {
  SnRig rig;
  for (const std::string& id : {std::string("a/b"), std::string("a+"), std::string("#"),
                                std::string("a\0b", 3), std::string("\xff")}) {
    rig.send(1, plain(id));
    EXPECT_EQ(rig.last_to(1), "CONNACK code=3");
  }
  SnRig named({}, {{"r7", {}, "radio-7"}});
  named.send(1, plain("r7"));
  EXPECT_EQ(named.last_to(1), "CONNACK code=3") << "that name belongs to another client";
  named.send(1, plain("radio-7"));
  EXPECT_EQ(named.last_to(1), "CONNACK code=0");
  EXPECT_EQ(named.presence.back().robot, "r7");
}

TEST(SnGateway, R33_IsSilentOrRejectsWhenFull) {
  Settings settings;
  settings.max_clients = 1;
  ConnectedRig silent(settings);
  silent.send(2, plain("r2"));
  EXPECT_TRUE(silent.is_silent(2));
  silent.send(1, plain("r1"));
  EXPECT_EQ(silent.last_to(1), "CONNACK code=0") << "an accepted client keeps its place";
  settings.when_full = WhenFull::reject;
  ConnectedRig rejecting(settings);
  rejecting.send(2, plain("r2"));
  EXPECT_EQ(rejecting.last_to(2), "CONNACK code=1");
  rejecting.send(1, Disconnect{});
  rejecting.sent_to(1);
  rejecting.send(2, plain("r2"));
  EXPECT_EQ(rejecting.last_to(2), "CONNACK code=0");
}

TEST(SnGateway, R34_AnswersTheSameConnectAgain) {
  SnRig rig;
  for (int i = 0; i < 3; ++i) {
    rig.send(1, plain("r1"));
    EXPECT_EQ(rig.last_to(1), "CONNACK code=0");
    rig.pass_s(8);
  }
  EXPECT_EQ(rig.presence.size(), 1U);
}

TEST(SnGateway, R35_ClearsTheSessionOnlyIfOtherMessagesCameSince) {
  ConnectedRig rig;
  const auto id = rig.register_topic(1, own_topic);
  rig.send(1, plain("r1"));
  rig.publish(1, id, 0, 0);
  EXPECT_EQ(rig.last_to(1), "PUBACK id=1 msg=0 code=2") << "a new, clean session";

  SnRig will;  // CONNACK lost: Nordic's client repeats its CONNECT
  will.send(1, with_will("r1"));
  will.send(1, WillTopic{WireQos::zero, false, own_topic});
  will.send(1, WillMsg{});
  will.sent_to(1);
  will.pass_s(8);
  will.send(1, with_will("r1"));
  EXPECT_EQ(will.sent_to(1), Lines{"CONNACK code=0"});
}

TEST(SnGateway, R36_FollowsAClientToANewAddress) {
  SnRig rig;
  rig.send(1, with_will("r1", false));
  rig.send(1, WillTopic{WireQos::zero, false, own_topic});
  rig.send(1, WillMsg{});
  rig.subscribe(1, "a/x");
  rig.connect(2, "r1", false);
  EXPECT_TRUE(rig.reports.empty()) << "a move does not publish the will";
  rig.broker("a/x");
  EXPECT_TRUE(rig.is_silent(1));
  EXPECT_FALSE(rig.is_silent(2));
  rig.send(1, Pingreq{});
  EXPECT_EQ(rig.last_to(1), "DISCONNECT plain");
  EXPECT_EQ(rig.presence.back().address, "[fd00::2]:47193");
}

TEST(SnGateway, R36_KeepsACleanSessionThatMovesUnlessItIsLost) {
  ConnectedRig rig;
  rig.subscribe(1, "a/x");
  rig.connect(2, "r1", false);
  rig.broker("a/x");
  EXPECT_FALSE(rig.is_silent(2));

  ConnectedRig lost;
  lost.subscribe(1, "a/x");
  lost.pass_s(91);
  lost.connect(2, "r1", false);
  lost.broker("a/x");
  EXPECT_TRUE(lost.is_silent(2));
}

TEST(SnGateway, R37_GivesAnAddressToItsLatestClient) {
  SnRig rig;
  rig.send(1, with_will("a"));
  rig.send(1, WillTopic{WireQos::zero, false, "ntnu-slam/robot/a/gone"});
  rig.send(1, WillMsg{});
  rig.subscribe(1, "a/x");
  rig.connect(1, "b");
  ASSERT_EQ(rig.reports.size(), 1U) << "A is lost";
  EXPECT_EQ(rig.reports[0].robot, "a");
  rig.broker("a/x");
  EXPECT_TRUE(rig.is_silent(1)) << "B does not get A's message";

  SnRig sleeping;
  sleeping.connect(1, "a", false);
  sleeping.subscribe(1, "a/x");
  sleeping.sleep(1);
  sleeping.connect(1, "b");
  sleeping.broker("a/x");
  sleeping.send(2, Pingreq{"a"});
  EXPECT_EQ(sleeping.sent_to(2).size(), 2U) << "A wakes at another address";
  EXPECT_TRUE(sleeping.is_silent(1));
}

TEST(SnGateway, R38_SupervisesADurationOfZero) {
  ConnectedRig rig(true, 0);
  rig.pass_s(5399);
  EXPECT_EQ(rig.gateway.presence_of("r1"), Presence::online);
  rig.pass_s(2);
  EXPECT_EQ(rig.gateway.presence_of("r1"), Presence::offline);
}

TEST(SnGateway, R39_AnswersUnknownClientsWithDisconnect) {
  SnRig rig;
  Subscribe subscribe;
  subscribe.topic_name = "a/x";
  Unsubscribe unsubscribe;
  unsubscribe.topic_name = "a/x";
  Publish qos1;
  qos1.qos = WireQos::one;
  Publish qos2;
  qos2.qos = WireQos::two;
  for (const Packet& packet :
       {Packet{Register{0, 1, own_topic}}, Packet{Regack{}}, Packet{Publish{}}, Packet{qos1},
        Packet{qos2}, Packet{Puback{}}, Packet{Pubrec{}}, Packet{Pubrel{}}, Packet{Pubcomp{}},
        Packet{subscribe}, Packet{unsubscribe}, Packet{Pingreq{}}, Packet{Pingreq{"who"}},
        Packet{WillTopicUpd{}}, Packet{WillMsgUpd{}}}) {
    rig.send(1, packet);
    EXPECT_EQ(rig.sent_to(1), Lines{"DISCONNECT plain"}) << describe(packet);
  }
  for (const Packet& packet : {Packet{Pingresp{}}, Packet{WillTopic{}}, Packet{WillMsg{}}}) {
    rig.send(1, packet);
    EXPECT_TRUE(rig.is_silent(1)) << describe(packet);
  }
  for (int i = 0; i < 1000; ++i) rig.send(1, Pingreq{});
  EXPECT_LE(rig.sent_to(1).size(), 20U);
  Settings quiet;
  quiet.disconnect_unknown = false;
  SnRig silent(quiet);
  silent.send(1, Pingreq{});
  EXPECT_TRUE(silent.is_silent(1));
}

TEST(SnGateway, R40_AnswersDisconnectFromAnyAddress) {
  SnRig rig;
  rig.send(1, Disconnect{});
  EXPECT_EQ(rig.last_to(1), "DISCONNECT plain");
}

TEST(SnGateway, R41_TreatsDisconnectedAndLostClientsAsUnknown) {
  Settings settings;
  settings.revive_lost = false;
  SnRig rig(settings);
  rig.connect(1, "r1", false);
  const auto id = rig.register_topic(1, own_topic);
  rig.send(1, Disconnect{});
  rig.sent_to(1);
  rig.publish(1, id, 1, 5);
  EXPECT_EQ(rig.last_to(1), "DISCONNECT plain");
  rig.connect(1, "r1", false);
  rig.pass_s(100);
  rig.publish(1, id, 1, 5);
  EXPECT_EQ(rig.last_to(1), "DISCONNECT plain");
  EXPECT_TRUE(rig.reports.empty());
}

TEST(SnGateway, R31_RefusesTheNamesOfRobotsOnOtherMeshes) {
  SnRig rig({}, {{"both", 0x0102, "c2", {}}, {"on-ble", 0x0101, {}, {}}});
  std::set<std::string> elsewhere{"lego-1", "both", "on-ble"};
  rig.gateway.refuse_names([&](const std::string& robot) { return elsewhere.contains(robot); });
  for (const std::string name : {"lego-1", "on-ble", "both", "ble-0100"}) {
    rig.send(1, Connect{false, true, 1, 60, name});
    EXPECT_EQ(rig.last_to(1), "CONNACK code=3") << name;
  }
  rig.connect(2, "c2");
  EXPECT_EQ(rig.presence.back().robot, "both") << "the configuration names it";
  rig.send(3, Connect{true, true, 1, 60, "lego-2"});
  elsewhere.insert("lego-2");  // taken on the other mesh during the handshake
  rig.send(3, WillTopic{WireQos::zero, false, ""});
  EXPECT_EQ(rig.last_to(3), "CONNACK code=3");
}

TEST(SnGateway, ReportsTooManyOpenWillHandshakes) {
  SnRig rig;
  for (unsigned n = 0; n <= limits::max_handshakes; ++n) {
    const std::string id = "c" + std::to_string(n);
    rig.connect(n, id);
    rig.send(n, Connect{true, true, 1, 60, id});
  }
  ASSERT_FALSE(rig.notices.empty());
  EXPECT_NE(rig.notices.back().text.find("1024 clients with wills are connecting already"),
            std::string::npos)
      << rig.notices.back().text;
}

TEST(SnGateway, R81_RefusesQosMinusOneForARobotOfAnotherMesh) {
  Settings settings;
  settings.allow_unconnected_publish = true;
  const std::vector<std::string> robots = {"ble-0100", "lego-1", "on-ble", "free", "both"};
  for (std::size_t i = 0; i < robots.size(); ++i) {
    settings.predefined_topics.push_back(
        {static_cast<std::uint16_t>(i + 1), "ntnu-slam/robot/" + robots[i] + "/adv", {}});
  }
  SnRig rig(settings, {{"both", 0x0102, "c2", {}}, {"on-ble", 0x0101, {}, {}}},
            {"ntnu-slam/robot/#"});
  rig.gateway.refuse_names([](const std::string& robot) { return robot == "lego-1"; });
  for (std::uint16_t id = 1; id <= robots.size(); ++id)
    rig.send(1, Publish{false, WireQos::minus_one, false, TopicIdType::predefined, id, 0, {}});
  ASSERT_EQ(rig.reports.size(), 2U);
  EXPECT_EQ(rig.reports[0].robot, "free");
  EXPECT_EQ(rig.reports[1].robot, "both");
  EXPECT_EQ(rig.counter("unconnected_refused"), 3U);
}

TEST(SnGateway, R81_RefusesQosMinusOneForBannedRobotsAndOldNames) {
  Settings settings;
  settings.allow_unconnected_publish = true;
  settings.predefined_topics = {{1, "ntnu-slam/robot/tank/adv", {}},
                                {2, "ntnu-slam/robot/c2/adv", {}}};
  const std::vector<RobotName> names = {{"tank", {}, "c2"}};
  SnRig rig(settings, names, {"ntnu-slam/robot/#"});
  const auto publish = [&](std::uint16_t id) {
    rig.send(1, Publish{false, WireQos::minus_one, false, TopicIdType::predefined, id, 0, {}});
    return rig.reports.size();
  };
  EXPECT_EQ(publish(1), 1U);
  EXPECT_EQ(publish(2), 1U) << "the client is tank";
  rig.gateway.reconfigure(rig.policy, RobotNames(names, Bans({"tank"})), {}, rig.now);
  EXPECT_EQ(publish(1), 1U);
}

TEST(SnGateway, ReportsTheBanWhenABannedRobotsClientConnects) {
  SnRig rig;
  const std::vector<RobotName> names{{"lego", std::nullopt, "NRF_5"}};
  rig.gateway.reconfigure(rig.policy, RobotNames(names, Bans({"lego"})), {}, rig.now);
  rig.send(1, Connect{false, true, 1, 60, "NRF_5"});
  ASSERT_EQ(rig.notices.size(), 1U);
  EXPECT_NE(rig.notices[0].text.find("'NRF_5' (CONNACK 0x03): it is banned"), std::string::npos)
      << rig.notices[0].text;
}

}  // namespace
}  // namespace slamgw::mqttsn
