// SPDX-License-Identifier: Apache-2.0
// The messages and keys that Nordic's board reports to the program that opens its port, by its
// recordings. It reports all messages that it receives, and keys only while a robot joins
// (docs/security.md).
#include <gtest/gtest.h>

#include <algorithm>
#include <set>
#include <vector>

#include "tests/ble_mesh_usb_cdc/hex.hpp"
#include "tests/support/transcript.hpp"

namespace slamgw::ble {
namespace {

constexpr std::size_t key_octets = 16;
constexpr std::uint8_t provisioning_complete = 0xc5;
constexpr std::uint8_t message_received = 0xd0;

/// Subnet Add and Update, Appkey Add and Update, Devkey Add: the key is their end.
const std::set<std::uint8_t> key_commands{0x92, 0x93, 0x97, 0x98, 0x9c};

bool holds(const Bytes& octets, const Bytes& part) {
  return std::search(octets.begin(), octets.end(), part.begin(), part.end()) != octets.end();
}

/// Splits octets into packets, which begin with their length.
std::vector<Bytes> packets_of(const Bytes& written) {
  std::vector<Bytes> packets;
  for (std::size_t at = 0; at < written.size(); at += 1u + written[at]) {
    const std::size_t end = std::min(written.size(), at + 1u + written[at]);
    packets.emplace_back(written.begin() + static_cast<std::ptrdiff_t>(at),
                         written.begin() + static_cast<std::ptrdiff_t>(end));
  }
  return packets;
}

std::set<Bytes> keys_of(const test::Transcript& transcript) {
  std::set<Bytes> keys;
  for (const test::Exchange& exchange : transcript.exchanges)
    for (const Bytes& packet : packets_of(exchange.command))
      if (packet.size() > key_octets + 2 && key_commands.contains(packet[1]))
        keys.emplace(packet.end() - key_octets, packet.end());
  keys.erase(Bytes(key_octets, 0));
  return keys;
}

/// Returns true for packets in which the recording uses octets of keys for other content: echoes,
/// the UUID, the label of a virtual address.
bool is_readable(const Bytes& packet) {
  constexpr std::uint8_t echo = 0x82, response = 0x84, uuid_get = 0x54, address_get = 0xa7;
  return packet.at(1) == echo ||
         (packet.at(1) == response && (packet.at(2) == uuid_get || packet.at(2) == address_get));
}

/// Returns the opcodes of the packets that carry a key.
std::set<std::uint8_t> opcodes_with_keys(const test::Transcript& transcript) {
  std::set<std::uint8_t> opcodes;
  const std::set<Bytes> keys = keys_of(transcript);
  EXPECT_GE(keys.size(), 2u) << transcript.name;
  for (const test::Exchange& exchange : transcript.exchanges)
    for (const test::RecordedPacket& packet : exchange.answers)
      for (const Bytes& key : keys)
        if (!is_readable(packet.octets) && holds(packet.octets, key))
          opcodes.insert(packet.octets.at(1));
  return opcodes;
}

TEST(BoardKeys, AreNotReadBackByAnyCommand) {
  for (const std::string& release : test::releases_of("board.txt"))
    EXPECT_EQ(opcodes_with_keys(test::read_transcript("board.txt", "board", release)),
              std::set<std::uint8_t>{})
        << release;
}

TEST(BoardKeys, AreSentWhileARobotJoins) {
  for (const std::string& release : test::releases_of("life.txt"))
    EXPECT_EQ(opcodes_with_keys(test::read_transcript("life.txt", "life", release)),
              std::set<std::uint8_t>{provisioning_complete})
        << release;
}

/// A robot's answer to Config AppKey Add, 80 03, which on the air is encrypted twice.
TEST(BoardKeys, ReceivedMessagesReachHostInClear) {
  for (const std::string& release : test::releases_of("life.txt")) {
    bool is_heard = false;
    for (const test::Exchange& exchange :
         test::read_transcript("life.txt", "life", release).exchanges)
      for (const test::RecordedPacket& packet : exchange.answers)
        is_heard = is_heard || (packet.octets.at(1) == message_received &&
                                holds(packet.octets, hex("80 03 00 00 00 00")));
    EXPECT_TRUE(is_heard) << release;
  }
}

}  // namespace
}  // namespace slamgw::ble
