// SPDX-License-Identifier: Apache-2.0
// Payloads at the bounds of segments, of the board and of the transport: each passes whole, or is
// refused as docs/topics.md says ("How long a payload may be").
#include <gtest/gtest.h>

#include "tests/ble_mesh_usb_cdc/mesh_rig.hpp"
#include "tests/ble_mesh_usb_cdc/serial_frame.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;

constexpr std::size_t opcode_octets = 3;
constexpr std::size_t most_reported = 235;  // of an access message, by the board
constexpr std::size_t most_sent = 244;

/// Returns octets that differ from their neighbours, so that a lost or doubled octet shows.
Bytes octets(std::size_t size) {
  Bytes bytes(size);
  for (std::size_t i = 0; i < size; ++i) bytes[i] = static_cast<std::uint8_t>(i * 7 + i / 256);
  return bytes;
}

class PayloadSizes : public ::testing::Test {
 protected:
  PayloadSizes() { rig.start(); }

  /// Sends a min_com SET of this size, of which the board reports as much as it has room for.
  void hear(std::size_t access_octets) {
    Bytes access = hex("c5 59 00") + octets(access_octets - opcode_octets);
    access.resize(std::min(access_octets, most_reported));
    rig.say(frame(0xd0, ByteWriter{}
                            .write_u16_le(first_robot)
                            .write_u16_le(0x0001)
                            .write_u16_le(0)
                            .write_u16_le(0)
                            .write_u8(4)
                            .write(hex("01 c4 3b f9 0b 6e 01 c9"))
                            .write_u16_le(static_cast<std::uint16_t>(access_octets))
                            .write(access)
                            .bytes()));
    for (const Report& report : rig.all<Report>()) rig.receipt(report.receipt.id);
    rig.run_for(1s);
  }
  std::size_t statuses() const {
    return static_cast<std::size_t>(std::ranges::count(rig.sent_to(first_robot), "c8590000"));
  }

  MeshRig rig;
};

TEST_F(PayloadSizes, FromRobotArriveWholeUpToBoardsMaximum) {
  std::size_t heard = 0;
  for (const std::size_t access : {3U, 8U, 10U, 11U, 12U, 20U, 21U, 234U, 235U}) {
    hear(access);
    ASSERT_EQ(rig.all<Report>().size(), ++heard) << access;
    EXPECT_EQ(rig.all<Report>().back().payload, octets(access - opcode_octets)) << access;
    EXPECT_EQ(statuses(), heard) << access;
  }
  EXPECT_EQ(rig.counter("rejected"), 0u);
}

TEST_F(PayloadSizes, FromRobotAreRejectedWithoutAcknowledgementWhenTruncated) {
  std::uint64_t rejected = 0;
  for (const std::size_t access : {236U, 244U, 379U, 380U, 381U, 65535U}) {
    hear(access);
    EXPECT_EQ(rig.counter("rejected"), ++rejected) << access;
  }
  EXPECT_TRUE(rig.all<Report>().empty());
  EXPECT_EQ(statuses(), 0u) << "the robot keeps the message";
  EXPECT_TRUE(rig.is_up());
}

TEST_F(PayloadSizes, ToRobotAreSentWholeUpToBoardsMaximum) {
  for (const std::size_t access : {3U, 8U, 11U, 12U, 20U, 21U, 243U, 244U}) {
    const Bytes payload = octets(access - opcode_octets);
    rig.command("nr1/blob", payload);
    rig.run_for(20ms);
    EXPECT_EQ(rig.board.sent.back().payload, hex("c5 59 00") + payload) << access;
    rig.hear(first_robot, "c8 59 00 00");
    EXPECT_EQ(rig.all<CommandOutcome>().back().result, CommandResult::delivered) << access;
    rig.run_for(5s);
  }
}

TEST_F(PayloadSizes, ToARobotAreRefusedAtOnceWhenTheyAreLonger) {
  for (const std::size_t access : {245U, 379U, 380U, 381U, 65535U}) {
    rig.command("nr1/blob", octets(access - opcode_octets));
    EXPECT_EQ(rig.all<CommandOutcome>().back().result, CommandResult::refused) << access;
    EXPECT_NE(rig.all<CommandOutcome>().back().why.find("at most 241"), std::string::npos);
  }
  rig.run_for(1s);
  EXPECT_TRUE(rig.board.sent.empty());
}

TEST(PayloadSizesOfOldBoards, ToARobotAreShorter) {
  MeshRig rig;
  rig.board.serial_version = 6;  // 2.0, or 2.1, which reports the same version
  rig.start();
  rig.command("nr1/blob", octets(86));
  EXPECT_EQ(rig.all<CommandOutcome>().back().result, CommandResult::refused);
  rig.command("nr1/blob", octets(85));
  rig.run_for(20ms);
  EXPECT_EQ(rig.board.sent.back().payload, hex("c5 59 00") + octets(85));
}

/// The table of docs/topics.md.
TEST(Segments, AreAsManyAsInDocumentedTable) {
  const auto of_payload = [](std::size_t size) { return segments_of(size + opcode_octets); };
  EXPECT_EQ(of_payload(8), 1u);
  EXPECT_EQ(of_payload(9), 2u);
  EXPECT_EQ(of_payload(17), 2u);
  EXPECT_EQ(of_payload(18), 3u);
  EXPECT_EQ(of_payload(29), 3u);
  EXPECT_EQ(of_payload(30), 4u);
  EXPECT_EQ(of_payload(most_reported - opcode_octets), 20u);
  EXPECT_EQ(of_payload(most_sent - opcode_octets), 21u);
  EXPECT_EQ(segments_of(380), 32u) << "the most of Mesh Profile 1.0 section 3.5.3.1";
}

}  // namespace
}  // namespace slamgw::ble
