// SPDX-License-Identifier: Apache-2.0
// Access messages: opcodes, vendor models, on/off.
#include <gtest/gtest.h>

#include "adapters/ble_mesh_usb_cdc/access/robot_models.hpp"
#include "tests/ble_mesh_usb_cdc/hex.hpp"

namespace slamgw::ble {
namespace {

TEST(Opcode, IsOneTwoOrThreeOctets) {
  EXPECT_EQ(decode_access(hex("04 00 59 00"))->opcode, 0x04u);
  EXPECT_EQ(decode_access(hex("82 04 01"))->opcode, 0x8204u);
  const Bytes update = hex("c9 59 00 0a 00 ec ff");
  const auto vendor = decode_access(update);
  EXPECT_EQ(vendor->opcode, 0xc95900u);
  EXPECT_EQ(to_hex(vendor->params), "0a00ecff");
  for (const std::string_view whole : {"04 01", "82 02 01 07", "c9 59 00 01"}) {
    const Bytes bytes = hex(whole);
    const auto message = decode_access(bytes);
    EXPECT_EQ(encode_access(message->opcode, message->params), bytes);
  }
}

TEST(Opcode, RejectsTruncatedAndReservedOpcodes) {
  EXPECT_EQ(decode_access({}).error(), DecodeError::too_short);
  EXPECT_EQ(decode_access(hex("82")).error(), DecodeError::too_short);
  EXPECT_EQ(decode_access(hex("c9 59")).error(), DecodeError::too_short);
  EXPECT_EQ(decode_access(hex("7f 00")).error(), DecodeError::bad_value);
}

TEST(Opcode, CountsSegmentsLikeTheSpecification) {
  EXPECT_EQ(segments_of(11), 1u);
  EXPECT_EQ(segments_of(12), 2u);
  EXPECT_EQ(segments_of(20), 2u);
  EXPECT_EQ(segments_of(23), 3u);
  EXPECT_EQ(segments_of(380), 32u);
}

TEST(VendorModels, MapOpcodesBothWays) {
  EXPECT_EQ(opcode_of({VendorModel::min_com, MessageKind::set}), 0xc55900u);
  EXPECT_EQ(opcode_of({VendorModel::min_com, MessageKind::status}), 0xc85900u);
  EXPECT_EQ(opcode_of({VendorModel::sensor_update, MessageKind::set_unreliable}), 0xcb5900u);
  EXPECT_EQ(opcode_of({VendorModel::pos_cmd, MessageKind::get}), 0xce5900u);
  EXPECT_EQ(opcode_of({VendorModel::pos_cmd, MessageKind::status}), 0xd05900u);
  EXPECT_EQ(opcode_of({VendorModel::min_com, MessageKind::set_numbered}), 0xd15900u);
  EXPECT_EQ(opcode_of({VendorModel::pos_cmd, MessageKind::set_numbered}), 0xd35900u);
  for (Opcode op = 0xc5; op <= 0xd3; ++op) {
    const Opcode opcode = op << 16 | 0x5900;
    const auto message = vendor_message_of(opcode);
    ASSERT_TRUE(message);
    EXPECT_EQ(opcode_of(*message), opcode);
  }
  for (const Opcode other : {0xc45900u, 0xd45900u, 0xc55a00u, 0xc55901u, 0x8202u, 0x04u, 0u})
    EXPECT_FALSE(vendor_message_of(other)) << other;
}

TEST(OnOff, SetCarriesStateAndTid) {
  EXPECT_EQ(encode_on_off_set(OnOffModel::generic, true, 7), hex("82 02 01 07"));
  EXPECT_EQ(encode_on_off_set(OnOffModel::simple, false, 8), hex("c1 59 00 00 08"));
}

}  // namespace
}  // namespace slamgw::ble
