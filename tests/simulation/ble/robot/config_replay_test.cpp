// SPDX-License-Identifier: Apache-2.0
// A simulated robot's configuration server answers each recorded message as Nordic's did.
#include <gtest/gtest.h>

#include "simulation/ble/robot/config_server.hpp"
#include "tests/simulation/hex.hpp"
#include "tests/support/transcript.hpp"

namespace slamgw::sim::ble {
namespace {

using test::Exchange;
using test::RecordedPacket;

constexpr std::uint8_t packet_send = 0xab;
constexpr std::size_t message_in_packet_send = 12;
constexpr std::uint8_t received_unicast = 0xd0;
constexpr std::size_t message_in_event = 21;

/// A message to or from the robot in a transcript; some octets may be undefined.
struct Message {
  Bytes octets;
  std::vector<bool> is_defined;

  std::string text() const {
    std::string out = to_hex(octets);
    for (std::size_t i = 0; i < octets.size(); ++i) {
      if (!is_defined[i]) out.replace(3 * i, 2, "..");
    }
    return out;
  }
  bool matches(const Bytes& other) const {
    if (other.size() != octets.size()) return false;
    for (std::size_t i = 0; i < octets.size(); ++i) {
      if (is_defined[i] && octets[i] != other[i]) return false;
    }
    return true;
  }
};

/// Returns the robot's answer among the board's packets.
std::optional<Message> answer_in(const Exchange& exchange) {
  for (const RecordedPacket& packet : exchange.answers) {
    if (packet.octets[1] != received_unicast) continue;
    return Message{{packet.octets.begin() + message_in_event, packet.octets.end()},
                   {packet.is_defined.begin() + message_in_event, packet.is_defined.end()}};
  }
  return std::nullopt;
}

/// Masks the content of composition data, as the recorded robot has another composition.
void undefine_composition(Message& answer) {
  constexpr std::size_t product = 4;
  constexpr std::size_t version = 6;
  constexpr std::size_t models = 15;
  for (const std::size_t i : {product, product + 1, version, version + 1}) {
    answer.is_defined[i] = false;
  }
  answer.octets.resize(models);
  answer.is_defined.resize(models);
}

class ConfigReplay {
 public:
  explicit ConfigReplay(const std::string& release) : firmware_(*find_firmware(release)) {
    ProvisioningData data;
    data.net_key = to_key(hex("101112131415161718191a1b1c1d1e1f"));
    data.address = 0x0100;
    configuration_.join(data, Key{});
  }

  void run(const Exchange& exchange) {
    const Bytes message(exchange.command.begin() + message_in_packet_send, exchange.command.end());
    std::optional<Message> wanted = answer_in(exchange);
    Answer answer = ConfigServer(firmware_, configuration_).on_message(message).answer;
    const bool is_composition = answer && wanted && wanted->octets[0] == 0x02;
    if (is_composition) {
      undefine_composition(*wanted);
      answer->resize(wanted->octets.size());
    }
    const bool is_as_recorded =
        wanted.has_value() == answer.has_value() && (!wanted || wanted->matches(*answer));
    EXPECT_TRUE(is_as_recorded) << "line " << exchange.line << ": " << exchange.situation << "\n> "
                                << to_hex(message) << "\nrecorded  "
                                << (wanted ? wanted->text() : "nothing") << "\nsimulated "
                                << (answer ? to_hex(*answer) : "nothing");
  }

 private:
  static Key to_key(const Bytes& octets) {
    Key key{};
    std::copy(octets.begin(), octets.end(), key.begin());
    return key;
  }

  const Firmware& firmware_;
  NodeConfiguration configuration_;
};

TEST(ConfigReplay, AnswersEachMessageAsRecorded) {
  for (const std::string& release : test::releases_of("configuration.txt")) {
    ConfigReplay replay(release);
    int messages = 0;
    for (const Exchange& exchange :
         test::read_transcript("configuration.txt", "configuration", release).exchanges) {
      const bool is_message = !exchange.command.empty() && exchange.command[1] == packet_send;
      if (!is_message) continue;
      replay.run(exchange);
      ++messages;
    }
    EXPECT_EQ(messages, 175);
  }
}

}  // namespace
}  // namespace slamgw::sim::ble
