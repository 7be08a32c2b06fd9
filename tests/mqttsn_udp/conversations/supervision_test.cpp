// SPDX-License-Identifier: Apache-2.0
// Ping, keep-alive, loss and revival (R106-R113), and disconnecting (R130-R132).
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

bool is_active(const SnRig& rig) { return rig.gateway.presence_of("r1") == Presence::online; }

TEST(SnGateway, R106_AnswersAPlainPing) {
  ConnectedRig rig;
  rig.send(1, Pingreq{});
  EXPECT_EQ(rig.sent_to(1), Lines{"PINGRESP"});
}

TEST(SnGateway, R107_AnswersAPingWithClientIdOfAnActiveClient) {
  ConnectedRig rig;
  rig.subscribe(1, "a/x", 0);
  rig.send(1, Pingreq{"r1"});
  EXPECT_EQ(rig.sent_to(1), Lines{"PINGRESP"});
  EXPECT_TRUE(is_active(rig));
  rig.broker("a/x");
  EXPECT_EQ(rig.sent_to(1).size(), 1U) << "only PINGRESP, nothing is buffered";
}

TEST(SnGateway, R108_AcceptsAPingrespAtAnyTimeAndNeedsNone) {
  ConnectedRig rig;
  rig.pass_s(80);
  rig.send(1, Pingresp{});
  EXPECT_TRUE(rig.is_silent(1));
  rig.pass_s(80);
  EXPECT_TRUE(is_active(rig)) << "it was a sign of life";
}

TEST(SnGateway, PingsAClientAndTimesItsAnswer) {
  ConnectedRig rig;
  rig.ping(7, "r1");
  EXPECT_EQ(rig.sent_to(1), Lines{"PINGREQ client="});
  rig.pass(std::chrono::milliseconds{40});
  EXPECT_TRUE(rig.pings.empty());
  rig.send(1, Pingresp{});
  ASSERT_EQ(rig.pings.size(), 1U);
  EXPECT_EQ(rig.pings[0].id, 7U);
  const auto answer = nlohmann::json::parse(rig.pings[0].answer.json);
  EXPECT_EQ(answer["answered"], true);
  EXPECT_EQ(answer["after_ms"], 40.0);
  EXPECT_EQ(answer["mesh"], "thread");
}

TEST(SnGateway, ReportsWhyAPingWasNotAnswered) {
  ConnectedRig rig;
  rig.connect(2, "r2");
  rig.sleep(2);
  rig.ping(1, "r1");
  rig.ping(2, "r2");
  rig.ping(3, "r3");
  rig.pass_s(6);
  ASSERT_EQ(rig.pings.size(), 3U);
  const auto why = [&](std::size_t i) {
    return nlohmann::json::parse(rig.pings[i].answer.json)["why"].get<std::string>();
  };
  EXPECT_NE(why(0).find("asleep"), std::string::npos);
  EXPECT_NE(why(1).find("no MQTT-SN session"), std::string::npos);
  EXPECT_NE(why(2).find("no PINGRESP in 5 s"), std::string::npos);
  EXPECT_EQ(rig.pings[2].id, 1U);
}

TEST(SnGateway, BoundsOpenPings) {
  ConnectedRig rig;
  for (std::uint64_t id = 0; id <= OperatorPings::max_open; ++id) rig.ping(id, "r1");
  ASSERT_EQ(rig.pings.size(), 1U);
  EXPECT_EQ(rig.pings[0].id, OperatorPings::max_open);
  EXPECT_EQ(rig.sent_to(1).size(), OperatorPings::max_open);
}

TEST(SnGateway, R109_CountsEveryMessageAsASignOfLife) {
  ConnectedRig rig;
  const auto id = rig.register_topic(1, own_topic);
  Unsubscribe unsubscribe;
  unsubscribe.topic_name = "a/x";
  Publish qos0;
  qos0.topic_id = id;
  for (const Packet& packet :
       {Packet{qos0}, Packet{Puback{}}, Packet{Regack{}}, Packet{Pubcomp{}}, Packet{unsubscribe},
        Packet{Register{0, 1, own_topic}}, Packet{Pingreq{}}, Packet{WillMsgUpd{}}}) {
    rig.pass_s(80);
    rig.send(1, packet);
    ASSERT_TRUE(is_active(rig)) << describe(packet);
  }
  rig.pass_s(91);
  EXPECT_FALSE(is_active(rig));
}

TEST(SnGateway, ReportsSignsOfLifeAtMostOnceASecond) {
  ConnectedRig rig;
  rig.signs_of_life = 0;
  Subscribe subscribe;
  subscribe.topic_name = "a/x";
  for (const Packet& packet : {Packet{Pingreq{}}, Packet{Pingreq{"r1"}}, Packet{subscribe},
                               Packet{Puback{}}, Packet{Regack{}}, Packet{Pubcomp{}}}) {
    rig.pass_s(2);
    for (int i = 0; i < 100; ++i) rig.send(1, packet);
  }
  EXPECT_EQ(rig.signs_of_life, 6U);
}

TEST(SnGateway, DoesNotCountAPingOfADisconnectedClientAsASignOfLife) {
  ConnectedRig rig(false);
  rig.send(1, Disconnect{});
  rig.pass_s(2);
  rig.signs_of_life = 0;
  for (const char* client_id : {"", "r1"}) {
    rig.send(1, Pingreq{client_id});
    EXPECT_EQ(rig.last_to(1), "DISCONNECT plain");
  }
  EXPECT_EQ(rig.signs_of_life, 0U);
}

TEST(SnGateway, R110_WaitsOneAndAHalfDurations) {
  for (const std::uint16_t duration_s :
       {std::uint16_t{10}, std::uint16_t{60}, std::uint16_t{600}}) {
    ConnectedRig rig(true, duration_s);
    rig.pass(std::chrono::milliseconds(duration_s * 1500 - 1));
    EXPECT_TRUE(is_active(rig)) << duration_s;
    rig.pass(std::chrono::milliseconds(1));
    EXPECT_FALSE(is_active(rig)) << duration_s;
  }
  Settings settings;
  settings.keep_alive_tolerance = 3;
  ConnectedRig patient(settings);
  patient.pass_s(179);
  EXPECT_TRUE(is_active(patient));
}

TEST(SnGateway, R111_IgnoresAnEarlyDeadline) {
  SnRig rig;  // the machine gets time only as an argument
  rig.connect(1, "r1");
  ASSERT_TRUE(rig.gateway.deadline());
  rig.gateway.on_deadline(rig.now);  // before the deadline
  EXPECT_TRUE(is_active(rig));
}

TEST(SnGateway, R112_PublishesTheWillAndKeepsOrForgetsTheSession) {
  Settings settings;
  settings.revive_lost = false;
  for (const bool clean : {true, false}) {
    SnRig rig(settings);
    rig.send(1, Connect{true, clean, 1, 60, "r1"});
    rig.send(1, WillTopic{WireQos::zero, false, own_topic});
    rig.send(1, WillMsg{});
    rig.subscribe(1, "a/x");
    rig.pass_s(100);
    EXPECT_EQ(rig.reports.size(), 1U);
    EXPECT_TRUE(rig.is_silent(1)) << "without an unsolicited DISCONNECT";
    EXPECT_EQ(rig.gateway.presence_of("r1").has_value(), !clean);
    EXPECT_EQ(rig.unsubscribes.size(), clean ? 1U : 0U);
    EXPECT_EQ(rig.presence.back().presence, Presence::offline);
  }
}

TEST(SnGateway, R113_RevivesALostClientFromItsAddress) {
  for (const bool clean : {true, false}) {
    ConnectedRig rig(clean);
    const auto id = rig.register_topic(1, own_topic);
    rig.subscribe(1, "a/x", 0);
    rig.pass_s(100);
    rig.send(2, Pingreq{"r1"});
    EXPECT_EQ(rig.last_to(2), "DISCONNECT plain") << "not revived from another address";
    rig.send(1, Pingreq{"r1"});
    EXPECT_EQ(rig.last_to(1), "PINGRESP");
    EXPECT_EQ(rig.presence.back().presence, Presence::online);
    rig.broker("a/x");
    EXPECT_FALSE(rig.is_silent(1)) << "its subscription is kept";
    rig.pass_s(100);
    rig.publish(1, id, 0, 0);
    EXPECT_EQ(rig.reports.back().topic, own_topic);
    EXPECT_TRUE(is_active(rig));
    EXPECT_EQ(rig.counter("clients_revived"), 2U);
  }
}

TEST(SnGateway, R113_EvictsALostCleanClientForANewOne) {
  Settings settings;
  settings.max_clients = 2;
  ConnectedRig rig(settings);
  rig.subscribe(1, "a/x");
  rig.connect(2, "r2", true, 6000);
  rig.send(3, Connect{false, true, 1, 60, "r3"});
  EXPECT_TRUE(rig.is_silent(3));
  rig.pass_s(100);
  rig.send(3, Connect{false, true, 1, 60, "r3"});
  EXPECT_EQ(rig.last_to(3), "CONNACK code=0");
  EXPECT_EQ(rig.unsubscribes.size(), 1U);
  rig.send(1, Pingreq{"r1"});
  EXPECT_EQ(rig.last_to(1), "DISCONNECT plain");
}

TEST(SnGateway, R113_RevivesACleanClientWithoutUndeliveredMessages) {
  ConnectedRig rig;
  rig.subscribe(1, "a/x");
  rig.broker("a/x", "1", 1);
  rig.pass_s(100);
  rig.sent_to(1);
  rig.broker("a/x", "2", 1);
  rig.send(1, Pingreq{"r1"});
  EXPECT_EQ(rig.sent_to(1), Lines{"PINGRESP"});
}

TEST(SnGateway, R130_AnswersADisconnectAndEndsSupervision) {
  ConnectedRig rig(false);
  rig.send(1, Disconnect{});
  EXPECT_EQ(rig.sent_to(1), Lines{"DISCONNECT plain"});
  EXPECT_EQ(rig.gateway.presence_of("r1"), Presence::offline);
  EXPECT_EQ(rig.presence.back().presence, Presence::offline);
  rig.pass_s(100000);
  EXPECT_EQ(rig.gateway.presence_of("r1"), Presence::offline);
  EXPECT_EQ(rig.counter("clients_lost"), 0U);
  rig.send(1, Pingreq{"r1"});  // would revive a lost client
  EXPECT_EQ(rig.sent_to(1), Lines{"DISCONNECT plain"});
}

TEST(SnGateway, R131_AnswersARepeatedDisconnect) {
  for (const bool clean : {true, false}) {
    ConnectedRig rig(clean);
    rig.send(1, Disconnect{});
    rig.send(1, Disconnect{});
    EXPECT_EQ(rig.sent_to(1), Lines(2, "DISCONNECT plain"));
  }
}

TEST(SnGateway, R132_NeverSendsADuration) {
  ConnectedRig rig;
  rig.send(1, Disconnect{300});
  EXPECT_EQ(to_hex(rig.datagrams.back().bytes), "0218");
}

}  // namespace
}  // namespace slamgw::mqttsn
