// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/bytes.hpp"

#include <gtest/gtest.h>

#include "daemon/core/utf8.hpp"

namespace slamgw {
namespace {

TEST(ByteReader, ReadsBothByteOrders) {
  const Bytes bytes{0x01, 0x02, 0x03, 0x04, 0x05, 0xec, 0xff, 0x78, 0x56, 0x34, 0x12};
  ByteReader reader(bytes);
  EXPECT_EQ(reader.read_u8(), 0x01);
  EXPECT_EQ(reader.read_u16_be(), 0x0203);
  EXPECT_EQ(reader.read_u16_le(), 0x0504);
  EXPECT_EQ(reader.read_i16_le(), -20);
  EXPECT_EQ(reader.read_u32_le(), 0x12345678u);
  EXPECT_TRUE(reader.at_end());
}

TEST(ByteReader, FailsPermanentlyAtTheFirstShortRead) {
  const Bytes bytes{0x01, 0x02, 0x03};
  ByteReader reader(bytes);
  EXPECT_EQ(reader.read_u32_le(), 0u);
  EXPECT_FALSE(reader.ok());
  EXPECT_EQ(reader.read_u8(), 0) << "reads 0 after a failure";
  EXPECT_TRUE(reader.read_rest().empty());
  EXPECT_FALSE(reader.at_end());
}

TEST(ByteReader, ReadsNothingFromAnEmptyView) {
  ByteReader reader({});
  EXPECT_TRUE(reader.read(0).empty());
  EXPECT_TRUE(reader.read_rest().empty());
  EXPECT_TRUE(reader.at_end());
}

TEST(ByteWriter, WritesBothByteOrders) {
  ByteWriter writer;
  writer.write_u8(1).write_u16_be(0x0203).write_u16_le(0x0504).write_i16_le(-20);
  writer.write_u32_le(0x12345678).write("hi");
  EXPECT_EQ(to_hex(writer.bytes()), "0102030405ecff785634126869");
}

TEST(Utf8, AcceptsWhatRfc3629Allows) {
  EXPECT_TRUE(is_utf8(""));
  EXPECT_TRUE(is_utf8("NRF_5"));
  EXPECT_TRUE(is_utf8("r\xc3\xb8ver"));
  EXPECT_TRUE(is_utf8("\xf0\x9f\xa4\x96"));
}

TEST(Utf8, RefusesWhatRfc3629Forbids) {
  EXPECT_FALSE(is_utf8("\xff"));
  EXPECT_FALSE(is_utf8("\xc3")) << "cut short";
  EXPECT_FALSE(is_utf8("\xc3\x28")) << "no continuation";
  EXPECT_FALSE(is_utf8("\xc0\xaf")) << "overlong";
  EXPECT_FALSE(is_utf8("\xed\xa0\x80")) << "surrogate";
  EXPECT_FALSE(is_utf8("\xf4\x90\x80\x80")) << "above U+10FFFF";
}

TEST(MqttText, AllowsTextThatEachBrokerAccepts) {
  EXPECT_TRUE(is_mqtt_text(""));
  EXPECT_TRUE(is_mqtt_text("r\xc3\xb8ver"));
  EXPECT_TRUE(is_mqtt_text("\xc2\xa0")) << "U+00A0";
  EXPECT_TRUE(is_mqtt_text("\xef\xbb\xbf")) << "U+FEFF is text (MQTT 5 section 1.5.4)";
  EXPECT_TRUE(is_mqtt_text("\xef\xb7\x8f\xef\xb7\xb0\xef\xbf\xbd")) << "U+FDCF, FDF0, FFFD";
  EXPECT_TRUE(is_mqtt_text("\xe2\x80\xae")) << "U+202E only looks odd";
  EXPECT_TRUE(is_mqtt_text(std::string(65535, 'x')));
}

TEST(MqttText, ForbidsCharactersForWhichSomeBrokerClosesTheConnection) {
  EXPECT_FALSE(is_mqtt_text(std::string_view("a\0b", 3)));
  EXPECT_FALSE(is_mqtt_text("\x01"));
  EXPECT_FALSE(is_mqtt_text("\x1f"));
  EXPECT_FALSE(is_mqtt_text("\x7f"));
  EXPECT_FALSE(is_mqtt_text("a\xc2\x80")) << "U+0080";
  EXPECT_FALSE(is_mqtt_text("a\xc2\x85")) << "U+0085";
  EXPECT_FALSE(is_mqtt_text("a\xc2\x9f")) << "U+009F";
  EXPECT_FALSE(is_mqtt_text("\xef\xb7\x90")) << "U+FDD0";
  EXPECT_FALSE(is_mqtt_text("\xef\xb7\xaf")) << "U+FDEF";
  EXPECT_FALSE(is_mqtt_text("\xef\xbf\xbe")) << "U+FFFE";
  EXPECT_FALSE(is_mqtt_text("\xef\xbf\xbf")) << "U+FFFF";
  EXPECT_FALSE(is_mqtt_text("\xf0\x9f\xbf\xbe")) << "U+1FFFE";
  EXPECT_FALSE(is_mqtt_text("\xf4\x8f\xbf\xbf")) << "U+10FFFF";
  EXPECT_FALSE(is_mqtt_text("\xed\xa0\x80")) << "surrogate";
  EXPECT_FALSE(is_mqtt_text(std::string(65536, 'x')));
}

}  // namespace
}  // namespace slamgw
