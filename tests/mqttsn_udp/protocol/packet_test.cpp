// SPDX-License-Identifier: Apache-2.0
// The codec against golden vectors in both directions, and against invalid datagrams.
#include <gtest/gtest.h>

#include "adapters/mqttsn_udp/protocol/packet.hpp"
#include "tests/mqttsn_udp/describe.hpp"
#include "tests/vectors/mqttsn_vectors.hpp"

namespace slamgw::mqttsn {
namespace {

Bytes long_publish() {
  Bytes bytes = hex(long_publish_header);
  for (unsigned i = 0; i < 291; ++i) bytes.push_back(static_cast<std::uint8_t>(0x61 + i % 26));
  return bytes;
}

/// Returns the same message with the 3-octet Length.
Bytes with_long_length(const Bytes& message) {
  ByteWriter writer;
  writer.write_u8(0x01).write_u16_be(static_cast<std::uint16_t>(message.size() + 2));
  writer.write(ByteView(message).subspan(1));
  return writer.take();
}

TEST(Packet, ReadsEveryVector) {
  for (const MessageVector& vector : message_vectors)
    EXPECT_EQ(describe_octets(hex(vector.wire)), vector.fields) << vector.name;
  EXPECT_EQ(describe_octets(long_publish()), long_publish_fields);
}

TEST(Packet, WritesEveryVectorAsItIsRead) {
  for (const MessageVector& vector : message_vectors) {
    const auto packet = decode(hex(vector.wire));
    ASSERT_TRUE(packet) << vector.name;
    if (vector.is_canonical) {
      EXPECT_EQ(to_hex(encode(*packet)), to_hex(hex(vector.wire))) << vector.name;
    }
  }
  EXPECT_EQ(to_hex(encode(*decode(long_publish()))), to_hex(long_publish()));
}

TEST(Packet, R1_ReadsTheThreeOctetLengthOnEveryMessage) {
  for (const MessageVector& vector : message_vectors) {
    if (!vector.is_canonical) continue;  // has the 3-octet Length already
    EXPECT_EQ(describe_octets(with_long_length(hex(vector.wire))), vector.fields) << vector.name;
  }
}

TEST(Packet, R2_WritesTheThreeOctetLengthFrom256Octets) {
  Publish publish;
  publish.payload.assign(248, 0x61);
  EXPECT_EQ(encode(publish)[0], 255);
  publish.payload.push_back(0x61);
  const Bytes bytes = encode(publish);
  EXPECT_EQ(to_hex(ByteView(bytes).first(4)), "0101020c");
  EXPECT_EQ(bytes.size(), 258U);
}

TEST(Packet, R3_RefusesALengthOtherThanTheDatagrams) {
  EXPECT_EQ(decode(hex("02 16 00")).error(), DecodeError::length_mismatch);
  EXPECT_EQ(decode(hex("04 16")).error(), DecodeError::length_mismatch);
  EXPECT_EQ(decode(hex("00 16")).error(), DecodeError::too_short);
}

TEST(Packet, R4_RefusesEveryVectorCutAtAnyOctet) {
  for (const MessageVector& vector : message_vectors) {
    const Bytes whole = hex(vector.wire);
    for (std::size_t size = 0; size < whole.size(); ++size)
      EXPECT_FALSE(decode(ByteView(whole).first(size))) << vector.name << " cut at " << size;
  }
  const Bytes whole = long_publish();
  for (std::size_t size = 0; size < whole.size(); ++size)
    EXPECT_FALSE(decode(ByteView(whole).first(size)));
}

TEST(Packet, R4_RefusesWrongSizesOfFixedMessages) {
  for (const std::string_view wire :
       {"04 05 00 00", "03 06 00", "03 08 00", "08 0b 00 05 00 01 00 00", "08 0d 00 05 00 01 00 00",
        "05 0e 00 02 00", "03 0f 00", "09 13 20 00 05 00 0a 00 00", "03 17 00", "04 1b 00 00",
        "08 12 21 00 0d 00 07 00", "06 14 01 00 10 00"})
    EXPECT_EQ(decode(hex(wire)).error(), DecodeError::malformed) << wire;
}

TEST(Packet, R5_RefusesReservedTypes) {
  for (unsigned type = 0x1e; type <= 0xfd; ++type) {
    const Bytes bytes{0x02, static_cast<std::uint8_t>(type)};
    EXPECT_EQ(decode(bytes).error(), DecodeError::unknown_type) << type;
  }
}

TEST(Packet, R7_IgnoresFlagsWithoutMeaning) {
  EXPECT_EQ(describe_octets(hex("08 04 f7 01 00 3c 72 31")),
            "CONNECT will=0 clean=1 protocol=1 duration=60 client=r1");
  EXPECT_EQ(describe_octets(hex("09 0c 0c 00 05 00 00 68 69")),
            "PUBLISH dup=0 qos=0 retain=0 normal id=5 msg=0 data=6869");
}

TEST(Packet, RefusesEveryInvalidDatagram) {
  for (const std::string_view wire : invalid_datagrams)
    EXPECT_EQ(describe_octets(hex(wire)), "invalid") << wire;
  EXPECT_FALSE(decode(Bytes(65507, 0x0c)));
}

TEST(Packet, R139_ReadsAndWritesForwardersHeaders) {
  for (const EncapsulationVector& vector : encapsulation_vectors) {
    const Bytes wire = hex(vector.wire);
    ASSERT_TRUE(is_encapsulated(wire)) << vector.name;
    const auto outer = decode_encapsulation(wire);
    ASSERT_EQ(outer.has_value(), !vector.fields.empty()) << vector.name;
    if (!outer) continue;
    EXPECT_EQ(outer->radius, vector.radius) << vector.name;
    EXPECT_EQ(to_hex(as_bytes(outer->node_id)), to_hex(hex(vector.node_id))) << vector.name;
    EXPECT_EQ(describe_octets(outer->inner), vector.fields) << vector.name;
    EXPECT_EQ(encode_encapsulation(outer->radius, outer->node_id, outer->inner), wire);
  }
}

TEST(Packet, R142_TakesNodeIdsUpTo252Octets) {
  const std::string longest(252, 'n');
  const Bytes wire = encode_encapsulation(0, longest, hex("02 16"));
  const auto outer = decode_encapsulation(wire);
  ASSERT_TRUE(outer);
  EXPECT_EQ(outer->node_id, longest);
  EXPECT_FALSE(decode_encapsulation(hex("05 fe 00 0a 0b 05 fe 00 0a 0b 02 16")));
  EXPECT_FALSE(decode_encapsulation(ByteView(wire).first(100)));
}

TEST(Packet, R142_IgnoresReservedControlBits) {
  const Bytes wire = hex("05 fe fd 0a 0b 02 16");
  const auto outer = decode_encapsulation(wire);
  ASSERT_TRUE(outer);
  EXPECT_EQ(outer->radius, 1);
}

}  // namespace
}  // namespace slamgw::mqttsn
