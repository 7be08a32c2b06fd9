// SPDX-License-Identifier: Apache-2.0
// Every command against the bytes that Nordic's host script writes.
#include "adapters/ble_mesh_usb_cdc/nordic/serial_protocol.hpp"

#include <gtest/gtest.h>

#include <numeric>

#include "tests/ble_mesh_usb_cdc/hex.hpp"
#include "tests/ble_mesh_usb_cdc/nordic/vectors.hpp"

namespace slamgw::ble {
namespace {

using u16 = std::uint16_t;

Key key_from(std::uint8_t first) {
  Key key;
  std::iota(key.begin(), key.end(), first);
  return key;
}

Bytes send(std::string_view payload, SerialVersion version = SerialVersion::sdk_3_1) {
  const Bytes access = hex(payload);
  return encode_packet_send(
      {.appkey_handle = 0, .source = 0x0001, .destination_handle = 2, .ttl = 8, .payload = access},
      version);
}

TEST(Commands, WithoutParametersAreOneOctet) {
  EXPECT_EQ(encode_command(CommandOpcode::serial_version_get), hex("01 09"));
  EXPECT_EQ(encode_command(CommandOpcode::housekeeping_get), hex("01 14"));
  EXPECT_EQ(encode_command(CommandOpcode::uuid_get), hex("01 54"));
  EXPECT_EQ(encode_command(CommandOpcode::local_unicast_get), hex("01 a0"));
  EXPECT_EQ(encode_command(CommandOpcode::address_get_all), hex("01 a8"));
  EXPECT_EQ(encode_command(CommandOpcode::subnet_get_all), hex("01 95"));
  EXPECT_EQ(encode_command(CommandOpcode::enable), hex("01 90"));
}

TEST(Commands, CarryHandlesAndAddressesLittleEndian) {
  EXPECT_EQ(encode_command(CommandOpcode::subscription_add, u16{0xc002}), hex("03 a1 02 c0"));
  EXPECT_EQ(encode_command(CommandOpcode::subscription_add, u16{0xc003}), hex("03 a1 03 c0"));
  EXPECT_EQ(encode_command(CommandOpcode::subscription_add, u16{0xc004}), hex("03 a1 04 c0"));
  EXPECT_EQ(encode_command(CommandOpcode::publication_add, u16{0x0100}), hex("03 a4 00 01"));
  EXPECT_EQ(encode_command(CommandOpcode::publication_add, u16{0xc003}), hex("03 a4 03 c0"))
      << "a group gets a handle as a robot does: recorded from all three releases";
  EXPECT_EQ(encode_command(CommandOpcode::publication_remove, u16{2}), hex("03 a6 02 00"));
  EXPECT_EQ(encode_command(CommandOpcode::address_get, u16{2}), hex("03 a7 02 00"));
  EXPECT_EQ(encode_command(CommandOpcode::appkey_get_all, u16{0}), hex("03 9a 00 00"));
  EXPECT_EQ(encode_command(CommandOpcode::local_unicast_set, u16{0x0001}, u16{1}),
            hex("05 9f 01 00 01 00"));
}

TEST(Commands, CarryKeysMostSignificantOctetFirst) {
  EXPECT_EQ(encode_command(CommandOpcode::subnet_add, u16{0}, key_from(0)),
            hex("13 92 00 00 00 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d 0e 0f"));
  EXPECT_EQ(encode_command(CommandOpcode::appkey_add, u16{0}, u16{0}, key_from(0x10)),
            hex("15 97 00 00 00 00 10 11 12 13 14 15 16 17 18 19 1a 1b 1c 1d 1e 1f"));
}

TEST(Commands, EchoCarriesItsNonce) {
  EXPECT_EQ(encode_command(CommandOpcode::echo, as_bytes("hi")), hex("03 02 68 69"));
}

TEST(Commands, PacketSendCarriesTheAccessMessage) {
  EXPECT_EQ(send("cd 59 00 0a 00 ec ff"),
            hex("12 ab 00 00 01 00 02 00 08 00 00 00 cd 59 00 0a 00 ec ff"));
  EXPECT_EQ(send("cc 59 00"), hex("0e ab 00 00 01 00 02 00 08 00 00 00 cc 59 00"));
  EXPECT_EQ(send("82 02 01 07"), hex("0f ab 00 00 01 00 02 00 08 00 00 00 82 02 01 07"));
  const Bytes longest(send_limit(SerialVersion::sdk_3_1), 1);
  EXPECT_EQ(encode_packet_send({.payload = longest}, SerialVersion::sdk_3_1).size(), 256u);
}

TEST(Commands, PacketSendHasFewerOptionsInOlderFirmware) {
  EXPECT_EQ(send("cc 59 00", SerialVersion::sdk_3_0),
            hex("0e ab 00 00 01 00 02 00 08 00 00 00 cc 59 00"));
  EXPECT_EQ(send("cc 59 00", SerialVersion::sdk_2_2),
            hex("0d ab 00 00 01 00 02 00 08 00 00 cc 59 00"));
  EXPECT_EQ(send("cc 59 00", SerialVersion::sdk_2_0),
            hex("0d ab 00 00 01 00 02 00 08 00 00 cc 59 00"));
  EXPECT_EQ(send("cc 59 00", SerialVersion::sdk_1_0),
            hex("0c ab 00 00 01 00 02 00 08 00 cc 59 00"));
}

TEST(Commands, LongestMessageFitsIntoOlderFirmwaresPackets) {
  constexpr std::size_t longest_frame = 98 + 1;
  for (const SerialVersion version : {SerialVersion::sdk_1_0, SerialVersion::sdk_2_0}) {
    const Bytes longest(send_limit(version), 1);
    EXPECT_LE(encode_packet_send({.payload = longest}, version).size(), longest_frame);
  }
}

TEST(Commands, FramesOfCommandsNotUsedHereAgreeToo) {
  for (const CommandVector& vector : unused_command_vectors) {
    const Bytes wire = hex(vector.wire);
    EXPECT_EQ(encode_frame(vector.opcode, ByteView(wire).subspan(2)), wire) << vector.name;
  }
}

}  // namespace
}  // namespace slamgw::ble
