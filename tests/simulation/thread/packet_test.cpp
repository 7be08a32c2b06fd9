// SPDX-License-Identifier: Apache-2.0
// MQTT-SN 1.2 golden vectors, from the specification's layouts and thesis figure 7.6.
#include "simulation/thread/packet.hpp"

#include <gtest/gtest.h>

#include "tests/simulation/hex.hpp"

namespace slamgw::sim::sn {
namespace {

std::string_view text(ByteView bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

TEST(Packet, WritesTheSpecificationsBytes) {
  EXPECT_EQ(to_hex(searchgw(1)), "03 01 01");
  EXPECT_EQ(to_hex(connect("NRF_5", 60, flag_clean_session)), "0b 04 04 01 00 3c 4e 52 46 5f 35");
  EXPECT_EQ(to_hex(connect("r1", 60, flag_clean_session | flag_will)), "08 04 0c 01 00 3c 72 31");
  EXPECT_EQ(to_hex(willtopic("w/1", 0)), "06 07 00 77 2f 31");
  EXPECT_EQ(to_hex(willmsg("dead")), "06 09 64 65 61 64");
  EXPECT_EQ(to_hex(register_topic(1, "a/b")), "09 0a 00 00 00 01 61 2f 62");
  EXPECT_EQ(to_hex(regack(5, 0x1234, 0)), "07 0b 00 05 12 34 00");
  EXPECT_EQ(to_hex(publish(0, 5, 0, hex("6869"))), "09 0c 00 00 05 00 00 68 69");
  EXPECT_EQ(to_hex(publish(1, 1, 48, hex("0a00ecff64002c0100"))),
            "10 0c 20 00 01 00 30 0a 00 ec ff 64 00 2c 01 00");
  EXPECT_EQ(to_hex(publish(2, 5, 2, hex("6869"))), "09 0c 40 00 05 00 02 68 69");
  EXPECT_EQ(to_hex(puback(1, 48, 0)), "07 0d 00 01 00 30 00");
  EXPECT_EQ(to_hex(qos2_step(Type::pubcomp, 2)), "04 0e 00 02");
  EXPECT_EQ(to_hex(qos2_step(Type::pubrec, 2)), "04 0f 00 02");
  EXPECT_EQ(to_hex(qos2_step(Type::pubrel, 2)), "04 10 00 02");
  EXPECT_EQ(to_hex(subscribe(1, 10, "a/b")), "08 12 20 00 0a 61 2f 62");
  EXPECT_EQ(to_hex(pingreq("NRF_5")), "07 16 4e 52 46 5f 35");
  EXPECT_EQ(to_hex(disconnect()), "02 18");
  EXPECT_EQ(to_hex(disconnect(300)), "04 18 01 2c");
  EXPECT_EQ(to_hex(publish_unconnected(7, hex("6869"))), "09 0c 61 00 07 00 00 68 69");
  EXPECT_EQ(to_hex(willtopicupd("w/2", 1)), "06 1a 20 77 2f 32");
  EXPECT_EQ(to_hex(willmsgupd("gone")), "06 1c 67 6f 6e 65");
}

TEST(Packet, UsesTheLongLengthFrom256Octets) {
  EXPECT_EQ(to_hex(ByteView(publish(1, 5, 32, Bytes(248, 0x61))).first(2)), "ff 0c");
  EXPECT_EQ(to_hex(ByteView(publish(1, 5, 32, Bytes(291, 0x61))).first(9)),
            "01 01 2c 0c 20 00 05 00 20");
}

TEST(Packet, ReadsMessagesOfGateways) {
  EXPECT_EQ(decode(hex("03 02 01"))->gateway_id, 1);
  EXPECT_EQ(decode(hex("08 02 01 04 0a 00 00 01"))->gateway_id, 1);
  EXPECT_EQ(decode(hex("03 05 01"))->return_code, congestion);
  EXPECT_EQ(decode(hex("03 1b 00"))->type, Type::willtopicresp);
  EXPECT_EQ(decode(hex("03 1d 03"))->return_code, 3);
  EXPECT_EQ(decode(hex("02 06"))->type, Type::willtopicreq);
  EXPECT_EQ(decode(hex("02 08"))->type, Type::willmsgreq);
  const Bytes register_bytes = hex("09 0a 00 05 12 34 61 2f 62");
  const auto registration = decode(register_bytes);
  EXPECT_EQ(registration->topic_id, 5);
  EXPECT_EQ(registration->msg_id, 0x1234);
  EXPECT_EQ(text(registration->payload), "a/b");
  const auto suback = decode(hex("08 13 20 00 05 00 0a 00"));
  EXPECT_EQ(suback->qos(), 1U);
  EXPECT_EQ(suback->topic_id, 5);
  EXPECT_EQ(suback->msg_id, 10);
  const Bytes publish_bytes = hex("09 0c a0 00 05 00 01 68 69");
  const auto published = decode(publish_bytes);
  EXPECT_EQ(published->qos(), 1U);
  EXPECT_EQ(text(published->payload), "hi");
  EXPECT_EQ(decode(hex("07 0d 00 05 00 01 02"))->return_code, 2);
  EXPECT_EQ(decode(hex("04 0f 00 02"))->msg_id, 2);
  EXPECT_EQ(decode(hex("01 00 05 05 00"))->type, Type::connack);  // long length on a short message
}

TEST(Packet, RejectsInvalidMessages) {
  for (const char* bad : {"",
                          "00",
                          "01",
                          "01 00",
                          "01 00 03",
                          "02",
                          "03 16",
                          "02 16 00",
                          "02 05",
                          "04 05 00 00",
                          "06 0d 00 05 00 01",
                          "05 0c 00 00 05",
                          "03 17 00",
                          "04 18 00 00",
                          "02 03",
                          "02 ff",
                          "02 1b",
                          "04 1d 00 00",
                          "06 1c 67 6f 6e 65",
                          "03 01 01",
                          "08 04 04 01 00 3c 72 31"}) {
    EXPECT_FALSE(decode(hex(bad)).has_value()) << bad;
  }
}

}  // namespace
}  // namespace slamgw::sim::sn
