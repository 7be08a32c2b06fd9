// SPDX-License-Identifier: Apache-2.0
// Retransmission and congestion (R133-R138), forwarders (R139-R143), the broker's side (R144-R147).
#include <gtest/gtest.h>

#include "adapters/mqttsn_udp/limits.hpp"
#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

Bytes wrapped(const std::string& node, const Packet& packet, std::uint8_t radius = 0) {
  return encode_encapsulation(radius, node, encode(packet));
}

TEST(SnGateway, R133_StopsAfterItsRepetitionsUntilTheClientIsHeard) {
  for (const bool clean : {true, false}) {
    ConnectedRig rig(clean, 6000);
    rig.subscribe(1, "a/x", 1);
    rig.broker("a/x", "1", 1);
    rig.broker("a/x", "2", 1);
    rig.pass_s(1000);
    EXPECT_EQ(rig.sent_to(1).size(), 10U)
        << "five at even intervals, then at growing ones, for 40 s";
    EXPECT_EQ(rig.gateway.presence_of("r1"), Presence::online)
        << "only the keep-alive makes a client lost";
    rig.send(1, Pingreq{});
    const Lines lines = rig.sent_to(1);
    ASSERT_EQ(lines.size(), 2U);
    const char* next = clean ? "dup=0 qos=1 retain=0 normal id=1 msg=2" : "dup=1 qos=1 retain=0";
    EXPECT_NE(lines[1].find(next), std::string::npos) << lines[1];
  }
}

TEST(SnGateway, R134_DoesNotRepeatAnswersByItself) {
  ConnectedRig rig(true, 6000);
  rig.register_topic(1, own_topic);
  rig.send(1, Subscribe{false, WireQos::one, TopicIdType::normal, 2, "a/z", 0});
  rig.publish(1, 1, 2, 3);
  rig.receipt(rig.reports.at(0).receipt.id);
  rig.sent_to(1);
  rig.pass_s(3000);
  EXPECT_TRUE(rig.is_silent(1));
}

TEST(SnGateway, R135_IgnoresRepeatedAnswers) {
  ConnectedRig rig(true, 6000);
  rig.subscribe(1, "a/+", 2);
  rig.broker("a/x", "1", 2);
  rig.send(1, Regack{1, 1, ReturnCode::accepted});
  rig.send(1, Regack{1, 1, ReturnCode::accepted});
  rig.send(1, Pubrec{2});
  rig.send(1, Pubrec{2});
  rig.send(1, Pubcomp{2});
  rig.send(1, Pubcomp{2});
  EXPECT_EQ(rig.sent_to(1), (Lines{"REGISTER id=1 msg=1 topic=a/x",
                                   "PUBLISH dup=0 qos=2 retain=0 normal id=1 msg=2 data=31",
                                   "PUBREL msg=2", "PUBREL msg=2"}));
  rig.pass_s(100);
  EXPECT_TRUE(rig.is_silent(1));
}

TEST(SnGateway, R136_UsesTheConfiguredTimers) {
  Settings settings;
  settings.retry_interval = std::chrono::seconds(2);
  settings.retry_count = 1;
  settings.advertise_interval = std::chrono::seconds(1000);
  SnRig rig(settings);
  rig.connect(1, "r1", true, 6000);
  rig.subscribe(1, "a/x", 1);
  rig.broker("a/x", "1", 1);
  rig.pass_s(100);
  EXPECT_EQ(rig.sent_to(1).size(), 2U);
  rig.pass_s(900);
  EXPECT_EQ(rig.multicasts, Lines{"ADVERTISE gw=1 duration=1000"});
}

TEST(SnGateway, R137_AnswersEveryRepeatedRequestTheSame) {
  ConnectedRig rig;
  rig.register_topic(1, own_topic);
  Publish qos1{false, WireQos::one, false, TopicIdType::normal, 1, 5, to_bytes("x")};
  for (const Packet& request :
       {Packet{Register{0, 1, own_topic}},
        Packet{Subscribe{false, WireQos::one, TopicIdType::normal, 2, "a/z", 0}},
        Packet{Register{0, 3, own_topic}}, Packet{Register{0, 4, own_topic}}, Packet{qos1},
        Packet{Pubrel{9}}, Packet{WillTopicUpd{WireQos::zero, false, own_topic}},
        Packet{WillMsgUpd{to_bytes("m")}}, Packet{Unsubscribe{TopicIdType::normal, 5, "a/z", 0}},
        Packet{Pingreq{"r1"}}, Packet{Disconnect{100}}}) {
    rig.send(1, request);
    if (!rig.reports.empty()) rig.receipt(rig.reports.back().receipt.id);
    const std::string first = rig.last_to(1);
    rig.send(1, request);
    EXPECT_EQ(rig.last_to(1), first) << describe(request);
  }
  EXPECT_EQ(rig.reports.size(), 1U);
  EXPECT_EQ(rig.subscribes.size(), 1U);
}

TEST(SnGateway, R138_AnswersCongestionWhereConfigured) {
  Settings settings;
  settings.when_full = WhenFull::reject;
  settings.max_clients = 1;
  ConnectedRig rig(settings);
  rig.send(2, Connect{false, true, 1, 60, "r2"});
  EXPECT_EQ(rig.last_to(2), "CONNACK code=1");
  for (std::size_t i = 0; i < limits::max_topics_per_client; ++i)
    rig.register_topic(1, "a/" + std::to_string(i));
  rig.send(1, Register{0, 1, "a/more"});
  EXPECT_EQ(rig.last_to(1), "REGACK id=0 msg=1 code=1");
  rig.send(1, Subscribe{false, WireQos::one, TopicIdType::normal, 2, "a/more", 0});
  EXPECT_EQ(rig.last_to(1), "SUBACK qos=0 id=0 msg=2 code=1");
}

TEST(SnGateway, R139_DistinguishesClientsBehindAForwarderByNodeId) {
  SnRig rig;
  rig.send_octets(1, hex("05 fe 00 0a 0b 08 04 04 01 00 3c 72 31"));
  EXPECT_EQ(to_hex(rig.datagrams.back().bytes), "05fe000a0b030500");
  EXPECT_EQ(rig.presence.back().address, "[fd00::1]:47193 via node 0a0b");
}

TEST(SnGateway, R140_WrapsEveryMessageForTheSameNode) {
  SnRig rig;
  rig.send_octets(1, wrapped("\x0a\x0b", Connect{false, true, 1, 60, "r1"}));
  rig.send_octets(
      1, wrapped("\x0a\x0b", Subscribe{false, WireQos::zero, TopicIdType::normal, 1, "a/x", 0}));
  rig.broker("a/x", "hi");
  for (const std::string& line : rig.sent_to(1))
    EXPECT_TRUE(line.starts_with("fwd(0a0b,0) ")) << line;
  rig.send_octets(1, wrapped("\x0a\x0b", SearchGw{1}, 2));
  EXPECT_EQ(rig.last_to(1), "fwd(0a0b,2) GWINFO gw=1 address=");
}

TEST(SnGateway, R141_KeepsNodesApartAndLetsClientsMoveBetweenThem) {
  SnRig rig;
  rig.send_octets(1, wrapped("A", Connect{false, false, 1, 60, "r1"}));
  rig.send_octets(1, wrapped("B", Connect{false, false, 1, 60, "r2"}));
  EXPECT_EQ(rig.gateway.presence_of("r1"), Presence::online);
  EXPECT_EQ(rig.gateway.presence_of("r2"), Presence::online);
  rig.send_octets(1,
                  wrapped("A", Subscribe{false, WireQos::zero, TopicIdType::normal, 1, "a/x", 0}));
  rig.sent_to(1);
  rig.broker("a/x");
  EXPECT_TRUE(rig.last_to(1).starts_with("fwd(41,0) "));
  rig.connect(2, "r1", false);  // without the forwarder
  rig.broker("a/x");
  EXPECT_TRUE(rig.is_silent(1));
  EXPECT_EQ(rig.sent_to(2), Lines{"REGISTER id=1 msg=1 topic=a/x"});
}

TEST(SnGateway, R142_DropsBrokenEncapsulation) {
  SnRig rig;
  for (const std::string_view wire :
       {"05 fe 00 0a 0b", "05 fe 00 0a 0b 05 fe 00 0a 0b 02 16", "05 fe 00 0a 0b 03 16",
        "03 fe 00 03 01 01", "ff fe 00 0a 0b 02 16"})
    rig.send_octets(1, hex(wire));
  EXPECT_TRUE(rig.is_silent(1));
  EXPECT_EQ(rig.counter("malformed"), 5U);
}

TEST(SnGateway, R143_AcceptsForwardersOnlyWhereAllowed) {
  Settings settings;
  settings.forwarders = false;
  SnRig rig(settings);
  rig.send_octets(1, wrapped("A", SearchGw{1}));
  rig.send_octets(1, wrapped("A", Connect{false, false, 1, 60, "r1"}));
  EXPECT_TRUE(rig.is_silent(1));
  EXPECT_EQ(rig.counter("unexpected"), 2U);
}

TEST(SnGateway, R144_ServesManyRobotsWithOneFilter) {
  SnRig rig;
  for (unsigned n = 0; n < 300; ++n) {
    rig.connect(n, "r" + std::to_string(n));
    rig.subscribe(n, "a/x", 0);
  }
  rig.datagrams.clear();
  rig.broker("a/x");
  EXPECT_EQ(rig.datagrams.size(), 300U);
}

TEST(SnGateway, R145_KeepsClientsWhileTheBrokerIsAway) {
  ConnectedRig rig;
  rig.subscribe(1, "a/x", 0);
  const auto id = rig.register_topic(1, own_topic);
  rig.broker_link(false);
  rig.send(1, Pingreq{});
  EXPECT_EQ(rig.last_to(1), "PINGRESP");
  rig.publish(1, id, 1, 5);
  EXPECT_EQ(rig.reports.size(), 1U) << "the core decides whether there is room";
  rig.connect(2, "r2");
  EXPECT_EQ(rig.gateway.presence_of("r2"), Presence::online)
      << "robots can reconnect without the broker";
  rig.broker_link(true);
  rig.broker("a/x");
  EXPECT_EQ(rig.sent_to(1).size(), 1U) << "subscriptions are kept";
}

TEST(SnGateway, R146_QueuesForEveryClientBeforeItReturns) {
  SnRig rig;
  for (unsigned n = 1; n <= 3; ++n) {
    rig.connect(n, "r" + std::to_string(n));
    rig.subscribe(n, "a/x", 1);
  }
  rig.sleep(2);
  rig.broker("a/x", "hi", 1);
  for (unsigned n = 1; n <= 3; ++n) EXPECT_EQ(rig.gateway.queued_for("r" + std::to_string(n)), 1U);
}

TEST(SnGateway, R147_NeverLetsOneClientWaitForAnother) {
  ConnectedRig rig;
  rig.connect(2, "r2");
  rig.subscribe(1, "a/#", 1);
  rig.subscribe(2, "a/x", 1);
  for (const char* payload : {"1", "2", "3"}) {
    rig.broker("a/x", payload, 1);
    const auto msg_id = std::get<Publish>(*decode(rig.datagrams.back().bytes)).msg_id;
    rig.send(2, Puback{1, msg_id, ReturnCode::accepted});
  }
  EXPECT_EQ(rig.sent_to(1).size(), 1U) << "only REGISTER, which r1 does not answer";
  EXPECT_EQ(rig.sent_to(2).size(), 3U);
}

TEST(SnGateway, AppliesNewNamesAndRulesWithoutDroppingSessions) {
  ConnectedRig rig;
  rig.connect(2, "r2");
  const auto id = rig.register_topic(1, "ntnu-slam/robot/r1/adv");
  rig.subscribe(1, "a/x", 0);
  rig.gateway.reconfigure(TopicPolicy(TopicScheme("ntnu-slam", "gw"), {}, {"b"}),
                          RobotNames({{"tank", {}, "r2"}}), {}, rig.now);
  rig.broker_link(true);  // drains
  EXPECT_TRUE(rig.is_silent(1));
  EXPECT_TRUE(rig.is_silent(2));
  EXPECT_EQ(rig.presence.back().robot, "tank");
  rig.broker("a/x");
  EXPECT_TRUE(rig.is_silent(1)) << "no longer allowed";
  rig.subscribe(1, "b", 0);
  rig.broker("b");
  EXPECT_EQ(rig.sent_to(1).size(), 1U);
  rig.publish(1, id, 1, 7);
  EXPECT_EQ(rig.reports.size(), 1U) << "the session is kept";
}

}  // namespace
}  // namespace slamgw::mqttsn
