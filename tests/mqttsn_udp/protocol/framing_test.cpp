// SPDX-License-Identifier: Apache-2.0
// Framing and malformed input at the gateway (R1-R10). The codec alone is in packet_test.cpp.
#include <gtest/gtest.h>

#include "adapters/mqttsn_udp/limits.hpp"
#include "tests/mqttsn_udp/sn_rig.hpp"
#include "tests/vectors/mqttsn_vectors.hpp"

namespace slamgw::mqttsn {
namespace {

TEST(SnGateway, R1_TakesTheThreeOctetLengthOnShortMessages) {
  SnRig rig;
  rig.send_octets(1, hex("01 00 0a 04 04 01 00 3c 72 31"));
  EXPECT_EQ(rig.last_to(1), "CONNACK code=0");
  rig.send_octets(1, hex("01 00 04 16"));
  EXPECT_EQ(rig.last_to(1), "PINGRESP");
}

TEST(SnGateway, R2_SendsTheThreeOctetLengthOnlyFrom256Octets) {
  ConnectedRig rig;
  rig.subscribe(1, "a/x");
  rig.broker("a/x", std::string(248, 'x'));
  EXPECT_EQ(rig.datagrams.back().bytes.size(), 255U);
  EXPECT_EQ(rig.datagrams.back().bytes[0], 255);
  rig.broker("a/x", std::string(249, 'x'));
  EXPECT_EQ(rig.datagrams.back().bytes.size(), 258U);
  EXPECT_EQ(rig.datagrams.back().bytes[0], 1);
}

/// Datagrams with lengths around the longer Length field and up to the largest that Thread carries.
TEST(SnGateway, R2_ForwardsWholePayloadsAtTheLengthBounds) {
  ConnectedRig rig;
  const auto id = rig.register_topic(1, own_topic);
  constexpr std::size_t header = 7;
  constexpr std::size_t long_header = 9;
  for (const std::size_t size : {254U, 255U, 256U, 257U, 258U, 1231U, 1232U}) {
    const bool is_long = size > 255;
    const std::size_t payload = size - (is_long ? long_header : header);
    ByteWriter datagram;
    if (is_long) datagram.write_u8(1).write_u16_be(static_cast<std::uint16_t>(size));
    if (!is_long) datagram.write_u8(static_cast<std::uint8_t>(size));
    datagram.write_u8(0x0c).write_u8(0x00).write_u16_be(id).write_u16_be(0);
    std::string text;
    for (std::size_t i = 0; i < payload; ++i) text += static_cast<char>('a' + i % 23);
    datagram.write(text);
    rig.send_octets(1, datagram.bytes());
    ASSERT_FALSE(rig.reports.empty()) << size;
    EXPECT_EQ(as_text(rig.reports.back().payload), text) << size;
  }
  EXPECT_EQ(rig.reports.size(), 7U);
  EXPECT_EQ(rig.counter("malformed") + rig.counter("oversized"), 0U);
}

TEST(SnGateway, R3_DropsAndCountsAWrongLength) {
  SnRig rig;
  rig.send_octets(1, hex("02 18 00"));
  rig.send_octets(1, hex("04 18 00"));
  rig.send_octets(1, hex("00 18"));
  EXPECT_TRUE(rig.is_silent(1));
  EXPECT_EQ(rig.counter("malformed"), 3U);
}

TEST(SnGateway, R4_DropsAndCountsEveryInvalidDatagram) {
  ConnectedRig rig;
  std::uint64_t invalid = 0;
  for (const std::string_view wire : invalid_datagrams) {
    rig.send_octets(1, hex(wire));
    rig.send_octets(2, hex(wire));
    invalid += 2;
    EXPECT_TRUE(rig.is_silent(1)) << wire;
    EXPECT_TRUE(rig.is_silent(2)) << wire;
  }
  EXPECT_EQ(rig.counter("malformed"), invalid);
  EXPECT_EQ(rig.gateway.presence_of("r1"), Presence::online);
  EXPECT_EQ(rig.notices.size(), 1U) << "one notice for the burst";
}

TEST(SnGateway, R5_IgnoresReservedTypes) {
  SnRig rig;
  for (const std::string_view wire : {"02 03", "02 11", "02 19", "02 1e", "02 fd", "02 ff"})
    rig.send_octets(1, hex(wire));
  EXPECT_TRUE(rig.is_silent(1));
  EXPECT_EQ(rig.counter("malformed"), 6U);
}

TEST(SnGateway, R6_IgnoresMessagesThatOnlyGatewaysSend) {
  ConnectedRig rig;
  for (const Packet& packet :
       {Packet{Connack{}}, Packet{WillTopicReq{}}, Packet{WillMsgReq{}}, Packet{Suback{}},
        Packet{Unsuback{}}, Packet{WillTopicResp{}}, Packet{WillMsgResp{}}, Packet{Advertise{2, 1}},
        Packet{GwInfo{2, {}}}}) {
    rig.send(1, packet);
    rig.send(2, packet);
  }
  EXPECT_TRUE(rig.is_silent(1));
  EXPECT_TRUE(rig.is_silent(2));
  EXPECT_EQ(rig.counter("unexpected"), 18U);
}

TEST(SnGateway, R7_IgnoresFlagsWithoutMeaning) {
  SnRig rig;
  rig.send_octets(1, hex("08 04 f7 01 00 3c 72 31"));
  EXPECT_EQ(rig.last_to(1), "CONNACK code=0") << "without a will handshake";
  rig.subscribe(1, "a/x");
  rig.broker("a/x", "hi", 1);
  EXPECT_EQ(rig.datagrams.back().bytes[2], 0x20);
}

TEST(SnGateway, R8_DropsMessagesThatTheNetworkCannotCarry) {
  ConnectedRig rig;
  rig.subscribe(1, "ntnu-slam/server/r1/cmd");
  rig.broker("ntnu-slam/server/r1/cmd", std::string(1223, 'x'));
  EXPECT_EQ(rig.datagrams.back().bytes.size(), 1232U) << "the largest one";
  rig.sent_to(1);
  rig.broker("ntnu-slam/server/r1/cmd", std::string(1224, 'x'));
  EXPECT_TRUE(rig.is_silent(1));
  EXPECT_EQ(rig.counter("too_large_down"), 1U);
  EXPECT_EQ(rig.outcomes.back().result, CommandResult::refused);
  rig.broker("ntnu-slam/server/r1/cmd", "next");
  EXPECT_NE(rig.last_to(1), "nothing") << "later messages are sent";
}

TEST(SnGateway, R8_DropsAnOverlongTopicOnlyIfItNeedsARegister) {
  const std::string longest(1225, 'x');  // of a SUBSCRIBE; a REGISTER has one octet more
  Settings settings;
  settings.predefined_topics = {{7, "a/" + longest, {}}};
  SnRig rig(settings, {}, {}, {"#"});
  rig.connect(1, "r1");
  rig.subscribe(1, longest, 0);
  rig.broker(longest);
  EXPECT_EQ(rig.counter("delivered_down"), 1U) << "the SUBACK has the topic id";
  rig.send(1, Subscribe{false, WireQos::zero, TopicIdType::predefined, 9, {}, 7});
  rig.broker("a/" + longest);
  EXPECT_EQ(rig.counter("delivered_down"), 2U);
  rig.connect(2, "r2");
  rig.subscribe(2, "#", 0);
  rig.broker(longest);
  EXPECT_EQ(rig.counter("delivered_down"), 3U);
  EXPECT_EQ(rig.counter("too_large_down"), 1U) << "the second client needs a REGISTER";
}

TEST(SnGateway, R9_DropsOverlongDatagrams) {
  ConnectedRig rig;
  const auto id = rig.register_topic(1, "ntnu-slam/robot/r1/adv");
  rig.publish(1, id, 0, 0, std::string(1223, 'x'));
  EXPECT_EQ(rig.reports.size(), 1U);
  rig.publish(1, id, 0, 0, std::string(1224, 'x'));
  rig.send_octets(1, Bytes(65507, 0x0c));
  EXPECT_EQ(rig.reports.size(), 1U);
  EXPECT_EQ(rig.counter("oversized"), 2U);
}

TEST(SnGateway, R10_BoundsAndExpiresHandshakesOfStrangers) {
  SnRig rig;
  for (unsigned n = 0; n < 3000; ++n)
    rig.send(n, Connect{true, true, 1, 60, "s" + std::to_string(n)});
  EXPECT_EQ(rig.counter("handshakes_given_up"), 3000U - limits::max_handshakes);
  rig.pass_s(41);  // after all repetitions
  EXPECT_EQ(rig.counter("handshakes_given_up"), 3000U);
  EXPECT_TRUE(rig.presence.empty());
  rig.send(1, Connect{true, true, 1, 60, "r1"});
  EXPECT_EQ(rig.last_to(1), "WILLTOPICREQ") << "the handshakes have expired";
}

TEST(SnGateway, R10_StrangersDoNotShutOutRobotsWithAWill) {
  SnRig rig;
  rig.connect(9001, "known", false);
  rig.send(9001, Connect{true, false, 1, 60, "known"});
  EXPECT_EQ(rig.last_to(9001), "WILLTOPICREQ");
  const auto flood = [&](unsigned from) {
    for (unsigned n = from; n < from + 2000; ++n)
      rig.send(n, Connect{true, true, 1, 60, "s" + std::to_string(n)});
  };
  flood(0);
  rig.send(9000, Connect{true, true, 1, 60, "new"});
  EXPECT_EQ(rig.last_to(9000), "WILLTOPICREQ") << "a new robot is answered";
  rig.send(9000, WillTopic{WireQos::zero, false, ""});
  EXPECT_EQ(rig.last_to(9000), "CONNACK code=0");
  flood(2000);
  rig.send(9001, WillTopic{WireQos::zero, false, ""});
  EXPECT_EQ(rig.last_to(9001), "CONNACK code=0") << "its handshake was not dropped for theirs";
}

}  // namespace
}  // namespace slamgw::mqttsn
