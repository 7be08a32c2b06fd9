// SPDX-License-Identifier: Apache-2.0
// slam_ble_models.h beside the daemon and the simulator, which share no code with it.
#include <gtest/gtest.h>

#include <array>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/access/robot_models.hpp"
#include "daemon/core/normalizer.hpp"
#include "simulation/ble/robot/robot.hpp"
#include "tests/firmware/headers.hpp"
#include "tests/mqttsn_udp/describe.hpp"

namespace slamgw::firmware {
namespace {

using mqttsn::hex;

slam_ble_message message_of(slam_ble_model model, slam_ble_kind kind, ByteView data,
                            std::uint8_t number = 0) {
  slam_ble_message message{};
  message.model = model;
  message.kind = kind;
  message.has_number = kind == SLAM_BLE_SET_NUMBERED;
  message.number = number;
  message.data = data.data();
  message.size = data.size();
  return message;
}

Bytes encoded(const slam_ble_message& message) {
  Bytes out(SLAM_BLE_MAX_SIZE);
  out.resize(slam_ble_encode(&message, out.data(), out.size()));
  return out;
}

slam_ble_message decoded(const Bytes& octets) {
  slam_ble_message message{};
  EXPECT_TRUE(slam_ble_decode(octets.data(), octets.size(), &message)) << to_hex(octets);
  return message;
}

TEST(BleModels, HaveTheOpcodesOfTheGateway) {
  for (unsigned model = 0; model < ble::vendor_model_count; ++model) {
    for (unsigned kind = 0; kind <= SLAM_BLE_SET_NUMBERED; ++kind) {
      const auto opcode = ble::opcode_of(
          {static_cast<ble::VendorModel>(model), static_cast<ble::MessageKind>(kind)});
      const slam_ble_message message =
          message_of(static_cast<slam_ble_model>(model), static_cast<slam_ble_kind>(kind), {});
      Bytes expected = ble::encode_access(opcode, {});
      if (kind == SLAM_BLE_SET_NUMBERED) expected.push_back(0);
      EXPECT_EQ(to_hex(encoded(message)), to_hex(expected));
      const slam_ble_message again = decoded(expected);
      EXPECT_EQ(static_cast<unsigned>(again.model), model);
      EXPECT_EQ(static_cast<unsigned>(again.kind), kind);
    }
  }
}

/// adapters/ble_mesh_usb_cdc/README.md, "What robots' firmware should do".
TEST(BleModels, WriteTheNumberedUpdateOfTheReadme) {
  const std::array<slam_position, 1> place{{{10, -20}}};
  Bytes parameters(SLAM_POSITION_SIZE);
  ASSERT_EQ(slam_encode_positions(place.data(), 1, parameters.data(), parameters.size()), 4U);
  const auto sent = message_of(SLAM_BLE_SENSOR_UPDATE, SLAM_BLE_SET_NUMBERED, parameters, 7);
  EXPECT_EQ(encoded(sent), hex("d2 59 00 07 0a 00 ec ff"));

  const Bytes status = hex("cc 59 00 00 07");
  const slam_ble_message answer = decoded(status);
  EXPECT_EQ(answer.number, 7);
  EXPECT_TRUE(slam_ble_acknowledges(&answer, &sent));
  EXPECT_EQ(encoded(answer), status);
}

TEST(BleModels, IgnoreTheStatusOfAnotherMessage) {
  const auto sent = message_of(SLAM_BLE_SENSOR_UPDATE, SLAM_BLE_SET_NUMBERED, {}, 7);
  for (const auto* octets : {"cc 59 00 00 06", "cc 59 00 00", "c8 59 00 00 07", "c9 59 00 00 07"}) {
    const Bytes wire = hex(octets);
    const slam_ble_message other = decoded(wire);
    EXPECT_FALSE(slam_ble_acknowledges(&other, &sent)) << octets;
  }
  const auto unnumbered = message_of(SLAM_BLE_SENSOR_UPDATE, SLAM_BLE_SET, {});
  const Bytes wire = hex("cc 59 00 00");
  const slam_ble_message status = decoded(wire);
  EXPECT_TRUE(slam_ble_acknowledges(&status, &unnumbered));
}

std::string status_for(const char* request) {
  const Bytes wire = hex(request);
  const slam_ble_message message = decoded(wire);
  Bytes out(8);
  out.resize(slam_ble_encode_status(&message, out.data(), out.size()));
  return to_hex(out);
}

TEST(BleModels, AnswerOnlyAcknowledgedRequests) {
  EXPECT_EQ(status_for("cd 59 00 0a 00 ec ff"), "d0590000");
  EXPECT_EQ(status_for("ce 59 00"), "d0590000");
  EXPECT_EQ(status_for("d3 59 00 2a 0a 00 ec ff"), "d05900002a");
  EXPECT_EQ(status_for("cf 59 00 0a 00 ec ff"), "");
  EXPECT_EQ(status_for("d0 59 00 00"), "");
}

TEST(BleModels, RejectInvalidAndForeignMessages) {
  slam_ble_message message{};
  for (const auto* octets : {"", "c9", "c9 59", "c4 59 00 01 02", "d4 59 00 00", "c9 00 59",
                             "c9 58 00", "d2 59 00", "cc 59 00 00 01 02", "82 02 01 00"}) {
    const Bytes wire = hex(octets);
    EXPECT_FALSE(slam_ble_decode(wire.data(), wire.size(), &message)) << octets;
  }
}

TEST(BleModels, WriteNothingIntoATooSmallBuffer) {
  const Bytes data(SLAM_BLE_MAX_SIZE, 1);
  Bytes out(SLAM_BLE_MAX_SIZE + 10);
  auto message = message_of(SLAM_BLE_MIN_COM, SLAM_BLE_SET_NUMBERED, data);
  message.size = SLAM_BLE_MAX_SIZE - 4;
  EXPECT_EQ(slam_ble_encode(&message, out.data(), out.size()), SLAM_BLE_MAX_SIZE);
  EXPECT_EQ(slam_ble_encode(&message, out.data(), SLAM_BLE_MAX_SIZE - 1), 0U);
  ++message.size;
  EXPECT_EQ(slam_ble_encode(&message, out.data(), out.size()), 0U);
  message.size = static_cast<std::size_t>(-1);
  EXPECT_EQ(slam_ble_encode(&message, out.data(), out.size()), 0U);
}

TEST(BleModels, EncodePositionsAsTheGatewayDoes) {
  const std::array<slam_position, 5> seen{
      {{10, -20}, {100, 300}, {-1, 0}, {32767, -32768}, {5, 6}}};
  for (std::size_t count = 1; count <= seen.size(); ++count) {
    Bytes update(SLAM_MAX_POSITIONS * SLAM_POSITION_SIZE);
    update.resize(slam_encode_positions(seen.data(), count, update.data(), update.size()));
    for (int stray = 0; stray < 2; ++stray) {
      const auto read = parse_update(update);
      ASSERT_TRUE(read.has_value());
      EXPECT_EQ(read->obstacles.size() + 1, count);
      std::array<slam_position, 5> again{};
      ASSERT_EQ(slam_decode_positions(update.data(), update.size(), again.data(), again.size()),
                count);
      EXPECT_EQ(again[count - 1].x_cm, seen[count - 1].x_cm);
      EXPECT_EQ(again[count - 1].y_cm, seen[count - 1].y_cm);
      EXPECT_EQ(read->robot.y_cm, again[0].y_cm);
      update.push_back(0x55);
    }
  }
  std::array<std::uint8_t, 24> room{};
  std::array<slam_position, 1> one{};
  EXPECT_EQ(slam_encode_positions(seen.data(), 0, room.data(), room.size()), 0U);
  EXPECT_EQ(slam_encode_positions(seen.data(), 6, room.data(), room.size()), 0U);
  EXPECT_EQ(slam_encode_positions(seen.data(), 2, room.data(), 7), 0U);
  for (const std::size_t size : {0U, 3U, 6U, 7U, 8U})
    EXPECT_EQ(slam_decode_positions(room.data(), size, one.data(), one.size()), 0U) << size;
}

TEST(BleModels, RepeatAfterTheIntervalsThatTheGatewayExpects) {
  for (unsigned ttl = 0; ttl <= 127; ++ttl) {
    for (std::size_t size = 3; size <= SLAM_BLE_MAX_SIZE; ++size) {
      const auto expected = ble::reliable_interval(static_cast<std::uint8_t>(ttl), size);
      EXPECT_EQ(
          std::chrono::milliseconds{slam_ble_interval_ms(static_cast<std::uint8_t>(ttl), size)},
          expected);
    }
  }
}

/// The simulated robot repeats at the same times. The clock wraps during this test.
TEST(BleModels, RepeatAtDoublingDistancesUntilAMinute) {
  const std::uint32_t begin = 0xfffffc00;
  slam_ble_repeat repeat{};
  slam_ble_repeat_begin(&repeat, begin, 4, 9);
  std::vector<std::uint32_t> at;
  std::uint32_t now = begin;
  for (int i = 0; i < 20 && slam_ble_repeat_is_open(&repeat); ++i) {
    now += slam_ble_repeat_wait_ms(&repeat, now);
    const slam_ble_step step = slam_ble_repeat_step(&repeat, now);
    if (step == SLAM_BLE_SEND_AGAIN) at.push_back(now - begin);
    if (step == SLAM_BLE_GIVE_UP) {
      EXPECT_EQ(now - begin, SLAM_BLE_GIVE_UP_MS);
    }
  }
  EXPECT_EQ(at, (std::vector<std::uint32_t>{280, 560, 1120, 2240, 4480, 8960, 17920, 35840}));
  EXPECT_EQ(slam_ble_repeat_step(&repeat, now), SLAM_BLE_WAIT);
  EXPECT_EQ(slam_ble_repeat_wait_ms(&repeat, now), UINT32_MAX);
}

TEST(BleModels, SendOneCopyWhenPolledLate) {
  slam_ble_repeat repeat{};
  slam_ble_repeat_begin(&repeat, 0, 4, 9);
  EXPECT_EQ(slam_ble_repeat_step(&repeat, 3000), SLAM_BLE_SEND_AGAIN);
  EXPECT_EQ(slam_ble_repeat_step(&repeat, 3000), SLAM_BLE_WAIT);
  EXPECT_EQ(slam_ble_repeat_wait_ms(&repeat, 3000), 1480U);
  slam_ble_repeat_end(&repeat);
  EXPECT_EQ(slam_ble_repeat_step(&repeat, 100000), SLAM_BLE_WAIT);
}

TEST(BleModels, EncodeTheSimulatedRobotsFirstUpdate) {
  using sim::ble::Robot;
  sim::ble::RobotSettings settings;
  settings.is_acknowledged = settings.is_numbered = true;
  Robot robot(settings, sim::RobotBody(1, 1));
  const sim::TimePoint begin{std::chrono::seconds{1}};
  const Robot::Publications to{Robot::Publication{0x0001, 4, {}}, Robot::Publication{0x0001, 4, {}},
                               std::nullopt};
  robot.on_start(begin);
  robot.on_deadline(to, begin);
  const auto greeting = robot.next_transmission();
  ASSERT_TRUE(greeting);
  const Bytes introduction = sim::RobotBody(1, 1).introduction();
  EXPECT_EQ(encoded(message_of(SLAM_BLE_MIN_COM, SLAM_BLE_SET_NUMBERED, introduction, 1)),
            greeting->message.payload);
  robot.on_message({0x0001, sim::ble::first_robot, 4, hex("c8 59 00 00 01")}, begin);
  robot.on_deadline(to, begin + std::chrono::seconds{1});
  const auto update = robot.next_transmission();
  ASSERT_TRUE(update);
  const Bytes measured = sim::RobotBody(1, 1).next_update();
  EXPECT_EQ(encoded(message_of(SLAM_BLE_SENSOR_UPDATE, SLAM_BLE_SET_NUMBERED, measured, 2)),
            update->message.payload);
}

}  // namespace
}  // namespace slamgw::firmware
