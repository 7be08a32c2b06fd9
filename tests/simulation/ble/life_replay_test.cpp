// SPDX-License-Identifier: Apache-2.0
// A simulated board and robot replay the recorded life of a gateway, a board and a robot. The
// recording begins at power on. Start-up, provisioning, configuration, commands and the robot's
// removal follow.
#include <gtest/gtest.h>

#include "tests/simulation/ble/replay_host.hpp"

namespace slamgw::sim::ble {
namespace {

using std::chrono::milliseconds;
using test::Exchange;
using test::RecordedPacket;
using test::Transcript;

constexpr std::uint8_t received_packet = 0xd0;
constexpr std::uint8_t tx_complete = 0xd2;
constexpr std::size_t message_in_packet = 21;

/// Returns true for messages that the robot sends by itself, whose place depends on the clock.
bool is_said_by_itself(const std::vector<std::uint8_t>& packet) {
  if (packet[1] != received_packet) return false;
  const std::uint8_t opcode = packet[message_in_packet];
  return opcode == 0xcb || opcode == 0xc9 || opcode == 0xc5 || opcode == 0xc7 || opcode == 0x04;
}

/// Returns true for TX Complete, which the recording's radio sends at once.
bool depends_on_clock(const std::vector<std::uint8_t>& packet) {
  return packet[1] == tx_complete || is_said_by_itself(packet);
}

bool is_composition(const std::vector<std::uint8_t>& packet) {
  return packet[1] == received_packet && packet[message_in_packet] == 0x02;
}

/// Masks the content of composition data, as the recorded robot has another composition.
RecordedPacket wanted_of(const RecordedPacket& packet) {
  RecordedPacket wanted = ReplayHost::without_device(packet);
  if (is_composition(packet.octets)) {
    wanted.octets.resize(message_in_packet + 4);
    wanted.is_defined.resize(wanted.octets.size());
    wanted.is_defined[0] = false;
    wanted.is_defined[message_in_packet - 2] = false;
  }
  return wanted;
}

void expect_as_recorded(const Exchange& exchange, std::vector<Bytes> answers) {
  std::erase_if(answers, depends_on_clock);
  std::vector<RecordedPacket> wanted;
  for (const RecordedPacket& packet : exchange.answers) {
    if (!depends_on_clock(packet.octets)) wanted.push_back(wanted_of(packet));
  }
  ASSERT_EQ(wanted.size(), answers.size()) << to_hex(exchange.command);
  for (std::size_t i = 0; i < answers.size(); ++i) {
    if (is_composition(answers[i])) answers[i].resize(wanted[i].octets.size());
    EXPECT_TRUE(wanted[i].matches(answers[i]))
        << "recorded  " << wanted[i].text() << "\nsimulated " << to_hex(answers[i]);
  }
}

void replay_life(const std::string& name, const BleOptions& options) {
  const std::string release(options.firmware->release);
  ReplayHost host(options);
  for (const Exchange& exchange : test::read_transcript("life.txt", name, release).exchanges) {
    SCOPED_TRACE(name + ", line " + std::to_string(exchange.line) + ": " + exchange.situation);
    const bool scans = exchange.command.size() == 2 && exchange.command[1] == 0x61;
    const milliseconds time{scans ? 1100 : 500};  // a device beacons each second
    expect_as_recorded(exchange, host.answers_to(exchange.command, time));
  }
}

TEST(LifeReplay, AnswersAsRecorded) { replay_life("life", MeshHost::unprovisioned()); }

TEST(LifeReplay, AnswersAsRecordedWithStaticOob) {
  BleOptions options = MeshHost::unprovisioned();
  options.static_oob = hex("6e6f726469635f6578616d706c655f31");  // "nordic_example_1"
  replay_life("life_static_oob", options);
}

}  // namespace
}  // namespace slamgw::sim::ble
