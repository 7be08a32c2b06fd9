// SPDX-License-Identifier: Apache-2.0
// COBS, the older robots' frames and ARQ, and the mesh that streams them. Vectors were made with
// the robots' own C code.
#include "adapters/ble_mesh_usb_cdc/cobs/cobs_mesh.hpp"

#include <gtest/gtest.h>

#include <algorithm>

#include "tests/ble_mesh_usb_cdc/event_log.hpp"
#include "tests/ble_mesh_usb_cdc/hex.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;

struct CobsVector {
  Bytes data;
  Bytes encoded;
};

std::vector<CobsVector> cobs_vectors() {
  const Bytes full(254, 0x11);
  return {{{}, hex("01")},
          {hex("00"), hex("01 01")},
          {hex("00 00"), hex("01 01 01")},
          {hex("11 22 00 33"), hex("03 11 22 02 33")},
          {hex("11 00 00 00"), hex("02 11 01 01 01")},
          {full, hex("ff") + full},
          {Bytes(255, 0xff), hex("ff") + Bytes(254, 0xff) + hex("02 ff")},
          {full + hex("00"), hex("ff") + full + hex("01 01")},
          {hex("0a 00 ec ff 00"), hex("02 0a 03 ec ff 01")},
          {hex("0a 00 ec ff 64 00 2c 01 00"), hex("02 0a 04 ec ff 64 03 2c 01 01")},
          {hex("0a 00 ec ff 64 00 2c 01"), hex("02 0a 04 ec ff 64 03 2c 01")}};
}

TEST(Cobs, AgreesWithTheRobotsCode) {
  for (const CobsVector& vector : cobs_vectors()) {
    EXPECT_EQ(encode_cobs(vector.data), vector.encoded) << to_hex(vector.data);
    const auto decoded = decode_cobs(vector.encoded);
    ASSERT_TRUE(decoded.has_value()) << to_hex(vector.data);
    EXPECT_EQ(*decoded, vector.data);
  }
}

TEST(Cobs, RejectsInvalidFrames) {
  EXPECT_EQ(decode_cobs({}).error(), DecodeError::too_short);
  EXPECT_EQ(decode_cobs(hex("05 11")).error(), DecodeError::too_short);
  EXPECT_EQ(decode_cobs(hex("03 11 00")).error(), DecodeError::bad_value);
  EXPECT_EQ(decode_cobs(hex("00")).error(), DecodeError::bad_value);
}

TEST(CobsSplitter, FindsFramesWhereverTheStreamIsCut) {
  const Bytes stream = hex("99 00 02 0a 00 00 03 11 22 00 05");
  for (std::size_t cut = 0; cut <= stream.size(); ++cut) {
    CobsSplitter splitter;
    auto frames = splitter.on_bytes(ByteView(stream).first(cut));
    for (const Bytes& frame : splitter.on_bytes(ByteView(stream).subspan(cut)))
      frames.push_back(frame);
    EXPECT_EQ(frames, (std::vector<Bytes>{hex("02 0a"), hex("03 11 22")})) << cut;
  }
}

TEST(CobsSplitter, DropsOversizedFrameAndContinues) {
  CobsSplitter splitter;
  splitter.on_bytes(hex("00"));
  EXPECT_TRUE(splitter.on_bytes(Bytes(100'000, 1)).empty());
  EXPECT_EQ(splitter.oversize(), 1u);
  EXPECT_EQ(splitter.on_bytes(hex("00 02 0a 00")).size(), 1u);
}

TEST(LienFrame, HasTheDallasCrc) {
  EXPECT_EQ(crc8_maxim(as_bytes("123456789")), 0xa1);
  EXPECT_EQ(crc8_maxim(hex("01")), 0x5e);
  EXPECT_EQ(crc8_maxim(hex("ff")), 0x35);
}

TEST(LienFrame, AgreesWithTheRobotsCode) {
  struct Vector {
    std::string_view raw;
    std::string_view wire;
  };
  constexpr Vector vectors[] = {
      {"00 02 01 02 37", "01 05 02 01 02 37 00"},
      {"02 00 01 03 21", "02 02 04 01 03 21 00"},
      {"00 02 01 01 00 68", "01 04 02 01 01 02 68 00"},
      {"02 00 01 00 00 05 00 02 0a 00 ec ff 42", "02 02 02 01 01 02 05 03 02 0a 04 ec ff 42 00"},
      {"00 02 00 00 00 01 0a 00 ec ff 5a 00 2d 00 14 28 50 5a 26",
       "01 02 02 01 01 03 01 0a 04 ec ff 5a 02 2d 06 14 28 50 5a 26 00"},
      {"00 02 00 00 00 09 1f", "01 02 02 01 01 03 09 1f 00"},
      {"02 00 01 00 01 01 00 04 f4", "02 02 02 01 03 01 01 03 04 f4 00"},
      {"00 02 01 00 00 01 00 03 04", "01 03 02 01 01 02 01 03 03 04 00"}};
  for (const Vector& vector : vectors) {
    const auto frame = decode_lien_frame(hex(vector.raw));
    ASSERT_TRUE(frame.has_value()) << vector.raw;
    EXPECT_EQ(encode_lien_frame(*frame), hex(vector.wire)) << vector.raw;
  }
}

TEST(LienFrame, RefusesEveryFlippedBit) {
  const Bytes whole = hex("00 02 00 00 00 09 1f");
  for (std::size_t bit = 0; bit < whole.size() * 8; ++bit) {
    Bytes flipped = whole;
    flipped[bit / 8] = static_cast<std::uint8_t>(flipped[bit / 8] ^ (1 << bit % 8));
    EXPECT_FALSE(decode_lien_frame(flipped).has_value()) << bit;
  }
  EXPECT_FALSE(decode_lien_frame({}).has_value());
}

// --- The mesh ------------------------------------------------------------------------------------

class CobsMeshTest : public ::testing::Test, protected EventLog {
 protected:
  void make(CobsContent content, std::optional<std::string> robot = "nr1") {
    Settings settings;
    settings.protocol = Protocol::cobs;
    settings.cobs_content = content;
    settings.robot_id = std::move(robot);
    settings.will = WillSettings{"lost/{id}", "gone"};
    mesh.emplace(settings, TopicScheme("ntnu-slam", "gw"), RobotNames({{"old2", 0x0002, {}}}));
    mesh->on_start();
    mesh->on_port_open(now);
    hear("00");  // ends a frame in progress
  }

  void hear(std::string_view wire) {
    mesh->on_bytes(hex(wire), now);
    drain();
  }
  void hear_lien(std::string_view raw_without_crc) {
    Bytes raw = hex(raw_without_crc);
    raw.push_back(crc8_maxim(raw));
    Bytes wire = encode_cobs(raw);
    wire.push_back(0);
    mesh->on_bytes(wire, now);
    drain();
  }
  void receipt(std::uint64_t id, ReceiptOutcome outcome = ReceiptOutcome::safe) {
    mesh->on_receipt(id, outcome, now);
    drain();
  }
  void drain() {
    while (auto action = mesh->next_action()) {
      if (auto* write = std::get_if<WriteSerial>(&*action)) written.push_back(write->bytes);
      if (auto* event = std::get_if<MeshEvent>(&*action)) events.push_back(std::move(*event));
    }
  }

  TimePoint now{};
  std::optional<CobsMesh> mesh;
  std::vector<Bytes> written;
};

TEST_F(CobsMeshTest, PublishesPositionsAsUpdatesOfConfiguredRobot) {
  make(CobsContent::positions);
  EXPECT_TRUE(all<LinkChange>().at(0).is_up);
  hear("02 0a 03 ec ff 01 00 02 0a 04 ec ff 64 03 2c 01 00");
  const auto reports = all<Report>();
  ASSERT_EQ(reports.size(), 2u);
  EXPECT_EQ(reports[0].topic, "ntnu-slam/robot/nr1/update");
  EXPECT_EQ(reports[0].payload, hex("0a 00 ec ff 00"));
  EXPECT_EQ(reports[1].payload, hex("0a 00 ec ff 64 00 2c 01"));
  EXPECT_FALSE(reports[0].receipt.is_owed());
  EXPECT_EQ(all<PresenceChange>().at(0).robot, "nr1");
}

TEST_F(CobsMeshTest, DropsIncompleteFrameAfterEachOpening) {
  make(CobsContent::positions);
  hear("02 0a");
  mesh->on_port_closed("gone", now);
  mesh->on_port_open(now);
  hear("03 ec ff 01 00 01 01 00");
  ASSERT_EQ(all<Report>().size(), 1u);
  EXPECT_EQ(all<Report>()[0].payload, hex("00"));
}

TEST_F(CobsMeshTest, RefusesCommandsWithOutcome) {
  make(CobsContent::positions);
  mesh->on_broker_message(
      {"nr1", {"ntnu-slam/server/nr1/cmd", hex("0a 00 ec ff"), Qos::at_least_once}, CommandId{1}},
      now);
  mesh->on_broker_message(
      {"other", {"ntnu-slam/server/other/cmd", hex("0a"), Qos::at_least_once}, CommandId{2}}, now);
  drain();
  ASSERT_EQ(all<CommandOutcome>().size(), 1u);
  EXPECT_EQ(all<CommandOutcome>()[0].id, CommandId{1});
  EXPECT_EQ(all<CommandOutcome>()[0].result, CommandResult::refused);
  EXPECT_NE(all<CommandOutcome>()[0].why.find("not supported by this link"), std::string::npos);
}

/// The robot is at another gateway: presence and will are due here only after it is heard again.
TEST_F(CobsMeshTest, AnnouncesGivenUpRobotWhenItIsHeardAgain) {
  make(CobsContent::positions);
  EXPECT_TRUE(all<SubscribeRequest>().at(0).is_standing) << "the robot may be at another gateway";
  hear("02 0a 04 ec ff 00 03 ec ff 01 00");
  EXPECT_FALSE(all<SubscribeRequest>().at(1).is_standing) << "the robot is at this gateway";
  events.clear();
  EXPECT_TRUE(mesh->give_up("nr1", now).empty());
  mesh->on_deadline(now + 1h);
  drain();
  EXPECT_TRUE(events.empty());
  hear("03 ec ff 01 00");
  ASSERT_EQ(all<PresenceChange>().size(), 1u);
  EXPECT_EQ(all<PresenceChange>()[0].presence, Presence::online);
  EXPECT_FALSE(all<SubscribeRequest>().at(0).is_standing);
}

TEST_F(CobsMeshTest, CountsBadFramesAndReportsThemOnce) {
  make(CobsContent::lien);
  hear("05 11 00 05 11 00 01 02 02 01 01 03 09 1e 00");
  EXPECT_EQ(mesh->counters().at(2).value, 3u);
  EXPECT_EQ(all<Notice>().size(), 1u);
  EXPECT_TRUE(all<Report>().empty());
}

TEST_F(CobsMeshTest, RenamesLienRobotsThatAreOnline) {
  make(CobsContent::lien);
  hear("01 02 02 01 01 03 09 1e 00");  // wrong CRC
  hear("01 02 02 01 01 03 01 0a 04 ec ff 5a 02 2d 06 14 28 50 5a 26 00");
  events.clear();
  mesh->on_names(RobotNames({{"new2", 0x0002, {}}, {"new3", 0x0003, {}}}), now);
  drain();
  const auto presence = all<PresenceChange>();
  ASSERT_EQ(presence.size(), 2u);
  EXPECT_EQ(presence[0].robot, "old2");
  EXPECT_EQ(presence[0].presence, Presence::offline);
  EXPECT_EQ(presence[1].robot, "new2");
  EXPECT_EQ(presence[1].presence, Presence::online);
  EXPECT_EQ(all<UnsubscribeRequest>().size(), 1u);
  EXPECT_EQ(all<SubscribeRequest>().size(), 2u) << "also for the robot that was not heard yet";
  EXPECT_TRUE(all<Report>().empty()) << "a renamed robot publishes no will";
}

TEST_F(CobsMeshTest, DropsMessagesOfBannedLienRobot) {
  make(CobsContent::lien);
  mesh->on_names(RobotNames({{"old2", 0x0002, {}}}, Bans({"old2"})), now);
  drain();
  events.clear();
  hear("01 02 02 01 01 03 01 0a 04 ec ff 5a 02 2d 06 14 28 50 5a 26 00");
  EXPECT_TRUE(all<Report>().empty());
  EXPECT_TRUE(all<PresenceChange>().empty());
}

TEST_F(CobsMeshTest, ABannedRobotGoesOfflineWithEitherContent) {
  const std::pair<CobsContent, const char*> cases[] = {
      {CobsContent::positions, "02 0a 03 ec ff 01 00"},
      {CobsContent::lien, "01 02 02 01 01 03 09 1f 00"}};
  for (const auto& [content, frame] : cases) {
    const std::string robot = content == CobsContent::positions ? "nr1" : "old2";
    make(content);
    hear(frame);
    ASSERT_EQ(mesh->presence_of(robot), Presence::online);
    mesh->on_names(RobotNames({{"old2", 0x0002, {}}}, Bans({robot})), now);
    drain();
    EXPECT_EQ(all<PresenceChange>().back().presence, Presence::offline);
    events.clear();
    hear(frame);
    EXPECT_TRUE(events.empty());
    EXPECT_EQ(mesh->presence_of(robot), Presence::offline);
    mesh->on_names(RobotNames({{"old2", 0x0002, {}}}), now);
    hear(frame);
    EXPECT_EQ(mesh->presence_of(robot), Presence::online);
  }
}

TEST_F(CobsMeshTest, PublishesSimpleLienMessagesByName) {
  make(CobsContent::lien);
  hear("01 02 02 01 01 03 01 0a 04 ec ff 5a 02 2d 06 14 28 50 5a 26 00");
  hear("01 02 02 01 01 03 09 1f 00");
  const auto reports = all<Report>();
  ASSERT_EQ(reports.size(), 3u);
  EXPECT_EQ(reports[0].topic, "ntnu-slam/robot/old2/update");
  EXPECT_EQ(reports[0].payload, hex("0a 00 ec ff"));
  EXPECT_EQ(reports[1].topic, "ntnu-slam/robot/old2/lien_update");
  EXPECT_EQ(reports[1].payload.size(), 13u);
  EXPECT_EQ(reports[2].topic, "ntnu-slam/robot/old2/ping_response");
}

TEST_F(CobsMeshTest, ReassemblesOrDropsSegmentedSimpleMessages) {
  make(CobsContent::lien);
  hear_lien("00 03 00 00 02 0b 41");
  hear_lien("00 03 00 01 02 42");
  hear_lien("00 03 00 02 02 43");
  hear_lien("00 03 00 00 02 0b 41");
  hear_lien("00 03 00 02 02 43");  // the middle was lost
  ASSERT_EQ(all<Report>().size(), 1u);
  EXPECT_EQ(all<Report>()[0].topic, "ntnu-slam/robot/ble-0003/debug");
  EXPECT_EQ(all<Report>()[0].payload, hex("0b 41 42 43"));
}

TEST_F(CobsMeshTest, AcknowledgesArqMessagesWhenTheyAreSafe) {
  make(CobsContent::lien);
  hear("01 05 02 01 02 37 00");  // SYN
  ASSERT_EQ(written.size(), 1u);
  EXPECT_EQ(written[0], hex("02 02 04 01 03 21 00"));
  hear("01 04 02 01 01 02 68 00");           // ACK 0
  hear("01 03 02 01 01 02 01 03 03 04 00");  // IDLE
  hear("01 03 02 01 01 02 01 03 03 04 00");  // a repeat, not answered yet
  ASSERT_EQ(all<Report>().size(), 1u);
  EXPECT_EQ(all<Report>()[0].topic, "ntnu-slam/robot/old2/idle");
  EXPECT_EQ(written.size(), 1u);
  receipt(all<Report>()[0].receipt.id);
  ASSERT_EQ(written.size(), 2u);
  const auto raw = decode_cobs(ByteView(written[1]).first(written[1].size() - 1));
  EXPECT_EQ(decode_lien_frame(*raw)->data, hex("01 01")) << "ACK of 0 names 1";
  hear("01 03 02 01 01 02 01 03 03 04 00");  // the ACK was lost
  EXPECT_EQ(all<Report>().size(), 1u);
  EXPECT_EQ(written.size(), 3u);
}

TEST_F(CobsMeshTest, ArqMessagesSpanSegmentsAndNumbersWrap) {
  make(CobsContent::lien);
  hear_lien("00 02 01 02");
  for (unsigned i = 0; i < 150; ++i) {
    Bytes first =
        hex("00 02 01 00") + Bytes{static_cast<std::uint8_t>((2 * i) & 0x7f)} + hex("03 00 0b 41");
    Bytes second =
        hex("00 02 01 00") + Bytes{static_cast<std::uint8_t>((2 * i + 1) & 0x7f)} + hex("42");
    hear_lien(to_hex(first));
    hear_lien(to_hex(second));
    ASSERT_EQ(all<Report>().size(), i + 1);
    EXPECT_EQ(all<Report>().back().payload, hex("0b 41 42"));
    receipt(all<Report>().back().receipt.id);
  }
}

TEST_F(CobsMeshTest, PublishesRepeatOfRefusedArqMessage) {
  make(CobsContent::lien);
  hear_lien("00 02 01 02");
  hear_lien("00 02 01 00 00 01 00 03");
  receipt(1, ReceiptOutcome::refused);
  EXPECT_EQ(written.size(), 1u);
  hear_lien("00 02 01 00 00 01 00 03");
  ASSERT_EQ(all<Report>().size(), 2u);
  receipt(2);
  EXPECT_EQ(written.size(), 2u);
}

TEST_F(CobsMeshTest, PublishesUpdateOfRefusedArqMessageOnce) {
  make(CobsContent::lien);
  const auto send = [&] {
    events.clear();
    hear_lien("00 02 01 00 00 0d 00 01 0a 00 ec ff 5a 00 2d 00 14 28 50 5a");
    return all<Report>();
  };
  const auto id_of = [](const std::vector<Report>& reports, std::string_view type) {
    for (const Report& each : reports)
      if (each.topic == "ntnu-slam/robot/old2/" + std::string(type)) return each.receipt.id;
    return std::uint64_t{0};
  };
  hear_lien("00 02 01 02");
  const auto first = send();
  ASSERT_EQ(first.size(), 2u);
  receipt(id_of(first, "update"));
  receipt(id_of(first, "lien_update"), ReceiptOutcome::refused);
  const auto second = send();
  ASSERT_EQ(second.size(), 1u) << "the update is safe";
  EXPECT_EQ(written.size(), 1u);
  receipt(id_of(second, "lien_update"));
  EXPECT_EQ(written.size(), 2u);
}

TEST_F(CobsMeshTest, AcknowledgesArqMessageOnlyWhenItsUpdateIsSafeToo) {
  make(CobsContent::lien);
  hear_lien("00 02 01 02");
  hear_lien("00 02 01 00 00 0d 00 01 0a 00 ec ff 5a 00 2d 00 14 28 50 5a");
  const auto first = all<Report>();
  ASSERT_EQ(first.size(), 2u);
  receipt(first[1].receipt.id);
  EXPECT_EQ(written.size(), 1u);
  receipt(first[0].receipt.id, ReceiptOutcome::refused);
  EXPECT_EQ(written.size(), 1u) << "the robot keeps the message";
  hear_lien("00 02 01 00 00 0d 00 01 0a 00 ec ff 5a 00 2d 00 14 28 50 5a");
  ASSERT_EQ(all<Report>().size(), 3u);
  EXPECT_EQ(all<Report>().back().topic, "ntnu-slam/robot/old2/update");
  receipt(all<Report>().back().receipt.id);
  EXPECT_EQ(written.size(), 2u);
}

TEST_F(CobsMeshTest, NewConnectionDropsOwedAcknowledgements) {
  make(CobsContent::lien);
  hear_lien("00 02 01 02");
  hear_lien("00 02 01 00 00 01 00 03");
  hear_lien("00 02 01 02");
  receipt(1);
  EXPECT_EQ(written.size(), 2u) << "only the two SYNACKs";
}

TEST_F(CobsMeshTest, SegmentsWithoutConnectionGetNoAnswer) {
  make(CobsContent::lien);
  hear_lien("00 02 01 00 00 01 00 03");
  EXPECT_TRUE(written.empty());
  EXPECT_TRUE(all<Report>().empty());
}

TEST_F(CobsMeshTest, EndsConnectionOfMessageThatExceedsBound) {
  make(CobsContent::lien);
  hear_lien("00 02 01 02");
  for (int i = 0; i < 200; ++i) {
    Bytes segment = hex("00 02 01 00") + Bytes{static_cast<std::uint8_t>(i & 0x7f)} + hex("ff ff") +
                    Bytes(40, 1);
    hear_lien(to_hex(segment));
  }
  EXPECT_LT(written.size(), 15u) << "after 512 octets the connection is over";
  EXPECT_TRUE(all<Report>().empty());
}

TEST_F(CobsMeshTest, SilentRobotsGoOfflineWithTheirWill) {
  make(CobsContent::lien);
  hear("01 02 02 01 01 03 09 1f 00");
  ASSERT_EQ(mesh->deadline(), now + 30s);
  now += 30s;
  mesh->on_deadline(now);
  drain();
  EXPECT_EQ(all<PresenceChange>().back().presence, Presence::offline);
  EXPECT_EQ(all<Report>().back().topic, "lost/old2");
  EXPECT_FALSE(mesh->deadline());
}

}  // namespace
}  // namespace slamgw::ble
