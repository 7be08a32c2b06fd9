// SPDX-License-Identifier: Apache-2.0
// Sleeping clients (R114-R129).
#include <gtest/gtest.h>

#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

std::string publish_line(int dup, int qos, int id, int msg_id, const std::string& payload) {
  return "PUBLISH dup=" + std::to_string(dup) + " qos=" + std::to_string(qos) +
         " retain=0 normal id=" + std::to_string(id) + " msg=" + std::to_string(msg_id) +
         " data=" + to_hex(as_bytes(payload));
}

/// A client, subscribed to "a/x" (id 1) at QoS 2, that sleeps for 100 s at a time.
struct SleepRig : SnRig {
  explicit SleepRig(bool clean = true, Settings settings = {}) : SnRig(std::move(settings)) {
    connect(1, "r1", clean);
    subscribe(1, "a/x", 2);
    sleep(1, 100);
  }
  Lines wake(unsigned n = 1) {
    send(n, Pingreq{"r1"});
    return sent_to(n);
  }
  Lines ack(std::uint16_t msg_id) {
    send(1, Puback{1, msg_id, ReturnCode::accepted});
    return sent_to(1);
  }
  bool is_asleep() const { return gateway.presence_of("r1") == Presence::asleep; }
};

TEST(SnGateway, R114_PutsAClientToSleepForItsDuration) {
  ConnectedRig rig;
  rig.send(1, Disconnect{100});
  EXPECT_EQ(rig.sent_to(1), Lines{"DISCONNECT plain"});
  EXPECT_EQ(rig.presence.back().presence, Presence::asleep);
  rig.pass_s(149);
  EXPECT_EQ(rig.gateway.presence_of("r1"), Presence::asleep)
      << "the keep-alive of 60 s does not apply";
  rig.pass_s(1);
  EXPECT_EQ(rig.gateway.presence_of("r1"), Presence::offline);
}

TEST(SnGateway, R115_TakesDuration0ForAPlainDisconnect) {
  ConnectedRig rig(false);
  rig.send_octets(1, hex("04 18 00 00"));
  EXPECT_EQ(rig.last_to(1), "DISCONNECT plain");
  EXPECT_EQ(rig.gateway.presence_of("r1"), Presence::offline);
}

TEST(SnGateway, R116_SendsNothingToASleepingClient) {
  ConnectedRig rig(true, 600);
  rig.subscribe(1, "a/x", 2);
  rig.subscribe(1, "a/+", 0);
  rig.broker("a/x", "1", 1);  // in flight
  rig.sleep(1, 1000);
  rig.broker("a/x", "2", 2);
  rig.broker("a/new", "3", 0);
  rig.pass_s(900);
  EXPECT_TRUE(rig.is_silent(1));
  EXPECT_EQ(rig.gateway.queued_for("r1"), 3U);
  rig.send(1, Pingreq{"r1"});
  EXPECT_EQ(rig.sent_to(1), Lines{publish_line(1, 1, 1, 1, "1")}) << "a repeat, so with DUP";
}

TEST(SnGateway, R117_BoundsTheBufferAndDropsQos0First) {
  Settings settings;
  settings.max_sleeping_messages = 3;
  SleepRig rig(true, settings);
  rig.broker("a/x", "1", 1);
  rig.broker("a/x", "2", 0);
  rig.broker("a/x", "3", 1);
  rig.broker("a/x", "4", 1);  // drops "2"
  rig.broker("a/x", "5", 1);  // drops "1"
  EXPECT_EQ(rig.gateway.queued_for("r1"), 3U);
  EXPECT_EQ(rig.counter("queue_dropped"), 2U);
  EXPECT_EQ(rig.wake(), Lines{publish_line(0, 1, 1, 1, "3")});
}

/// The robot may have obeyed a sent command.
TEST(SnGateway, R117_KeepsACommandThatWasSent) {
  const std::string command = "ntnu-slam/server/r1/cmd";
  Settings settings;
  settings.max_sleeping_messages = 2;
  ConnectedRig rig(settings);
  rig.subscribe(1, command, 1);
  rig.broker(command, "sent", 1);
  rig.sleep(1);
  rig.broker(command, "waits", 1);
  rig.broker(command, "waits, too", 1);
  ASSERT_EQ(rig.outcomes.size(), 1U);
  EXPECT_EQ(rig.outcomes[0].id, CommandId{2});
  EXPECT_EQ(rig.outcomes[0].result, CommandResult::refused);
}

TEST(SnGateway, R117_BoundsTheBufferInOctets) {
  Settings settings;
  settings.max_sleeping_messages = 10000;
  SleepRig rig(true, settings);
  for (int i = 0; i < 1000; ++i) rig.broker("a/x", std::string(1000, 'x'), 1);
  EXPECT_LT(rig.gateway.queued_for("r1"), 300U);
}

TEST(SnGateway, R118_WakesASleepingClientByPingreqFromAnyAddress) {
  SleepRig rig;
  rig.broker("a/x", "1", 1);
  rig.broker("a/x", "2", 2);
  rig.broker("a/x", "3", 0);
  EXPECT_EQ(rig.wake(2), Lines{publish_line(0, 1, 1, 1, "1")});
  rig.send(2, Puback{1, 1, ReturnCode::accepted});
  EXPECT_EQ(rig.sent_to(2), Lines{publish_line(0, 2, 1, 2, "2")}) << "one exchange at a time";
  rig.send(2, Pubrec{2});
  EXPECT_EQ(rig.sent_to(2), Lines{"PUBREL msg=2"});
  rig.send(2, Pubcomp{2});
  EXPECT_EQ(rig.sent_to(2), (Lines{publish_line(0, 0, 1, 0, "3"), "PINGRESP"}));
  EXPECT_TRUE(rig.is_silent(1)) << "the address has moved";
  EXPECT_EQ(rig.presence.back().address, "[fd00::2]:47193");
  rig.pass_s(149);
  EXPECT_TRUE(rig.is_asleep()) << "the same duration again";
  rig.pass_s(2);
  EXPECT_FALSE(rig.is_asleep());
}

TEST(SnGateway, R118_RegistersFirstWhereNeeded) {
  ConnectedRig rig;
  rig.subscribe(1, "a/+", 1);
  rig.sleep(1, 100);
  rig.broker("a/new", "1", 1);
  rig.send(1, Pingreq{"r1"});
  EXPECT_EQ(rig.sent_to(1), Lines{"REGISTER id=1 msg=1 topic=a/new"});
  rig.send(1, Regack{1, 1, ReturnCode::accepted});
  EXPECT_EQ(rig.sent_to(1), Lines{publish_line(0, 1, 1, 2, "1")});
  rig.send(1, Puback{1, 2, ReturnCode::accepted});
  EXPECT_EQ(rig.sent_to(1), Lines{"PINGRESP"});
}

TEST(SnGateway, R119_SendsPingrespByItselfRightAfterTheLastAck) {
  SleepRig rig;
  rig.broker("a/x", "1", 1);
  EXPECT_EQ(rig.wake(), Lines{publish_line(0, 1, 1, 1, "1")})
      << "PINGRESP does not come before the message";
  rig.pass_s(1);
  EXPECT_TRUE(rig.is_silent(1));
  EXPECT_EQ(rig.ack(1), Lines{"PINGRESP"}) << "without another PINGREQ";
  EXPECT_TRUE(rig.is_asleep());
}

TEST(SnGateway, R120_SendsPingrespAtOnceWithNothingBuffered) {
  SleepRig rig;
  EXPECT_EQ(rig.wake(), Lines{"PINGRESP"});
  EXPECT_TRUE(rig.is_asleep());
}

TEST(SnGateway, R121_DoesNotDeliverAgainAtTheNextPingreq) {
  SleepRig rig;
  rig.broker("a/x", "1", 1);
  rig.wake();
  rig.ack(1);
  EXPECT_EQ(rig.wake(), Lines{"PINGRESP"});
}

TEST(SnGateway, R122_DeliversABoundedNumberOfMessagesPerWakeUp) {
  Settings settings;
  settings.max_sleeping_messages = 2;
  SleepRig rig(true, settings);
  rig.broker("a/x", "1", 1);
  rig.wake();
  rig.broker("a/x", "2", 1);
  EXPECT_EQ(rig.ack(1), Lines{publish_line(0, 1, 1, 2, "2")});
  rig.broker("a/x", "3", 1);
  EXPECT_EQ(rig.ack(2), Lines{publish_line(0, 1, 1, 3, "3")});
  rig.broker("a/x", "4", 1);
  EXPECT_EQ(rig.ack(3), Lines{"PINGRESP"}) << "ends after a bounded number";
  EXPECT_TRUE(rig.is_silent(1));
  EXPECT_EQ(rig.wake(), Lines{publish_line(0, 1, 1, 4, "4")});
}

TEST(SnGateway, R123_DoesNotStartTwiceOnARepeatedPingreq) {
  SleepRig rig;
  rig.broker("a/x", "1", 1);
  EXPECT_EQ(rig.wake().size(), 1U);
  EXPECT_TRUE(rig.wake().empty());
  EXPECT_EQ(rig.ack(1), Lines{"PINGRESP"});
  EXPECT_EQ(rig.wake(), Lines{"PINGRESP"});
}

TEST(SnGateway, R124_StopsAndKeepsTheMessageWhenNoAckComes) {
  SleepRig rig;
  rig.broker("a/x", "1", 1);
  rig.wake();
  rig.pass_s(39);
  EXPECT_EQ(rig.sent_to(1).size(), 9U) << "repeated for 40 s";
  rig.pass_s(60);
  EXPECT_TRUE(rig.is_silent(1)) << "asleep again, without PINGRESP";
  EXPECT_TRUE(rig.is_asleep());
  EXPECT_EQ(rig.wake(), Lines{publish_line(1, 1, 1, 1, "1")});
}

TEST(SnGateway, R125_DeliversTheBufferOnConnectOrDiscardsIt) {
  SleepRig rig(false);
  rig.broker("a/x", "1", 0);
  rig.send(1, Connect{false, false, 1, 60, "r1"});
  EXPECT_EQ(rig.sent_to(1), (Lines{"CONNACK code=0", "REGISTER id=1 msg=1 topic=a/x"}));
  rig.send(1, Regack{1, 1, ReturnCode::accepted});
  EXPECT_EQ(rig.sent_to(1), Lines{publish_line(0, 0, 1, 0, "1")});
  EXPECT_EQ(rig.gateway.presence_of("r1"), Presence::online);
  SleepRig clean(false);
  clean.broker("a/x", "1", 1);
  clean.send(1, Connect{false, true, 1, 60, "r1"});
  EXPECT_EQ(clean.sent_to(1), Lines{"CONNACK code=0"});
  EXPECT_EQ(clean.gateway.queued_for("r1"), 0U);
}

TEST(SnGateway, R125_WakesARobotThatBeganWithACleanSession) {
  SnRig rig;
  rig.send(1, Connect{true, true, 1, 60, "r1"});
  rig.send(1, WillTopic{WireQos::zero, false, "ntnu-slam/robot/r1/gone"});
  rig.send(1, WillMsg{});
  const auto up = rig.register_topic(1, "ntnu-slam/robot/r1/update");
  rig.subscribe(1, "a/x");
  rig.sleep(1);
  rig.broker("a/x", "1", 1);
  rig.sent_to(1);
  rig.send(2, Connect{false, false, 1, 60, "r1"});
  EXPECT_EQ(rig.sent_to(2), (Lines{"CONNACK code=0", "REGISTER id=2 msg=1 topic=a/x"}));
  rig.publish(2, up, 0, 0);
  ASSERT_EQ(rig.reports.size(), 1U) << "its topics are kept";
  rig.pass_s(200);
  EXPECT_EQ(rig.reports.back().topic, "ntnu-slam/robot/r1/gone") << "its will is kept";
}

TEST(SnGateway, R126_TakesANewDurationOrAPlainDisconnectInSleep) {
  SleepRig rig(false);
  rig.pass_s(100);
  rig.send(1, Disconnect{200});
  EXPECT_EQ(rig.sent_to(1), Lines{"DISCONNECT plain"});
  rig.pass_s(299);
  EXPECT_TRUE(rig.is_asleep());
  rig.send(1, Disconnect{});
  EXPECT_EQ(rig.sent_to(1), Lines{"DISCONNECT plain"});
  EXPECT_EQ(rig.gateway.presence_of("r1"), Presence::offline);
}

TEST(SnGateway, R127_LosesASleeperThatDoesNotWake) {
  SnRig rig;
  rig.send(1, Connect{true, true, 1, 60, "r1"});
  rig.send(1, WillTopic{WireQos::zero, false, "ntnu-slam/robot/r1/gone"});
  rig.send(1, WillMsg{});
  rig.sleep(1, 100);
  rig.pass_s(151);
  ASSERT_EQ(rig.reports.size(), 1U);
  EXPECT_EQ(rig.presence.back().presence, Presence::offline);
}

/// The client has missed one wake-up. It sends no DISCONNECT, and its radio is off after PINGRESP.
TEST(SnGateway, R113_RevivesALostSleeperByItsPingreq) {
  SleepRig rig(false);
  rig.pass_s(151);
  EXPECT_EQ(rig.gateway.presence_of("r1"), Presence::offline);
  EXPECT_EQ(rig.wake(), Lines{"PINGRESP"});
  EXPECT_TRUE(rig.is_asleep());
  rig.broker("a/x", "1", 1);
  EXPECT_TRUE(rig.is_silent(1));
  rig.pass_s(120);
  EXPECT_TRUE(rig.is_asleep()) << "its keep-alive of 60 s does not apply";
  EXPECT_EQ(rig.wake(), Lines{publish_line(0, 1, 1, 1, "1")});
  EXPECT_EQ(rig.ack(1), Lines{"PINGRESP"});
  rig.connect(1, "r1", false);
  rig.pass_s(100);
  rig.send(1, Pingreq{});
  EXPECT_EQ(rig.gateway.presence_of("r1"), Presence::online) << "it was active when it was lost";
}

TEST(SnGateway, R113_LetsALostClientFallAsleep) {
  SleepRig rig(false);
  rig.connect(1, "r1", false);
  rig.pass_s(100);
  ASSERT_EQ(rig.gateway.presence_of("r1"), Presence::offline);
  rig.send(1, Disconnect{300});
  EXPECT_EQ(rig.sent_to(1), Lines{"DISCONNECT plain"});
  EXPECT_TRUE(rig.is_asleep());
  rig.broker("a/x", "1", 1);
  rig.pass_s(300);
  EXPECT_TRUE(rig.is_asleep());
  EXPECT_EQ(rig.wake(), Lines{"REGISTER id=1 msg=1 topic=a/x"}) << "sent at the wake-up";
}

TEST(SnGateway, R128_DoesNotMoveAnActiveClientByAPing) {
  ConnectedRig rig;
  rig.send(2, Pingreq{"r1"});
  EXPECT_EQ(rig.sent_to(2), Lines{"DISCONNECT plain"});
  rig.send(1, Pingreq{});
  EXPECT_EQ(rig.sent_to(1), Lines{"PINGRESP"});
  SleepRig plain;
  plain.broker("a/x", "1", 0);
  plain.send(1, Pingreq{});
  EXPECT_EQ(plain.sent_to(1), (Lines{publish_line(0, 0, 1, 0, "1"), "PINGRESP"}));
}

TEST(SnGateway, R129_ServesRequestsOfASleepingClient) {
  SleepRig rig;
  rig.send(1, Register{0, 1, "a/y"});
  rig.send(1, Subscribe{false, WireQos::one, TopicIdType::normal, 2, "a/z", 0});
  rig.send(1, Unsubscribe{TopicIdType::normal, 3, "a/x", 0});
  EXPECT_EQ(rig.sent_to(1), (Lines{"REGACK id=2 msg=1 code=0", "SUBACK qos=1 id=3 msg=2 code=0",
                                   "UNSUBACK msg=3"}));
  EXPECT_TRUE(rig.is_asleep());
}

}  // namespace
}  // namespace slamgw::mqttsn
