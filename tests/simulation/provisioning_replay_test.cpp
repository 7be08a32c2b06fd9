// SPDX-License-Identifier: Apache-2.0
// The simulated board provisions a simulated device as Nordic's board did a device of its release.
// Its own are the device's UUID and public key, hence the shared secret and the device key.
#include <gtest/gtest.h>

#include "tests/simulation/mesh_host.hpp"
#include "tests/support/transcript.hpp"

namespace slamgw::sim::ble {
namespace {

using std::chrono::milliseconds;
using test::Exchange;
using test::RecordedPacket;
using test::Transcript;

constexpr const char* oob_value = "6e6f726469635f6578616d706c655f31";  // "nordic_example_1"

BleOptions options_for(const Transcript& transcript, const std::string& release) {
  BleOptions options = MeshHost::unprovisioned();
  options.firmware = find_firmware(release);
  const bool has_oob = transcript.name == "provision_static_oob" ||
                       transcript.name == "provision_wrong_oob" ||
                       transcript.name == "provision_bad_choice";
  if (has_oob) options.static_oob = hex(oob_value);
  return options;
}

/// The event that asks for the shared secret, and the command that answers.
constexpr std::uint8_t ecdh_request = 0xc7;
constexpr std::uint8_t ecdh_secret = 0x68;

class ProvisioningReplay {
 public:
  ProvisioningReplay(const Transcript& transcript, const std::string& release)
      : transcript_(transcript), release_(release), host_(options_for(transcript, release)) {}

  void run() {
    for (const Exchange& exchange : transcript_.exchanges) {
      if (!exchange.command.empty()) host_.tell(command_of(exchange));
      host_.run(milliseconds{1100});  // a device beacons each second
      compare(exchange, take_packets());
    }
  }

 private:
  /// The recorded command with this device's UUID and shared secret.
  Bytes command_of(const Exchange& exchange) const {
    Bytes command = exchange.command;
    if (command[1] == 0x63) std::copy(uuid_.begin(), uuid_.end(), command.begin() + 3);
    const bool is_secret = command[1] == ecdh_secret && !request_.empty();
    if (!is_secret) return command;
    PublicKey peer{};
    PrivateKey own{};
    std::copy_n(request_.begin() + 3, peer.size(), peer.begin());
    std::copy_n(request_.begin() + 3 + peer.size(), own.size(), own.begin());
    const Secret secret = shared_secret(own, peer).value();
    std::copy(secret.begin(), secret.end(), command.begin() + 3);
    return command;
  }

  /// Without the beacons after the first.
  std::vector<Bytes> take_packets() {
    std::vector<Bytes> packets = std::move(host_.packets);
    host_.packets.clear();
    std::erase_if(packets,
                  [&](const Bytes& packet) { return packet[1] == 0xc0 && !uuid_.empty(); });
    for (const Bytes& packet : packets) {
      if (packet[1] == 0xc0) uuid_.assign(packet.begin() + 2, packet.begin() + 18);
      if (packet[1] == ecdh_request) request_ = packet;
    }
    return packets;
  }

  void compare(const Exchange& exchange, const std::vector<Bytes>& packets) const {
    const std::string where = release_ + " " + transcript_.name + ", line " +
                              std::to_string(exchange.line) + ": " + exchange.situation;
    const std::vector<RecordedPacket> wanted = wanted_of(exchange);
    ASSERT_EQ(wanted.size(), packets.size()) << where;
    for (std::size_t i = 0; i < packets.size(); ++i) {
      EXPECT_TRUE(wanted[i].matches(packets[i]))
          << where << "\nrecorded  " << wanted[i].text() << "\nsimulated " << to_hex(packets[i]);
    }
  }

  /// The recorded device has the static value at hand although it has not offered it; a simulated
  /// one has none, and refuses.
  std::vector<RecordedPacket> wanted_of(const Exchange& exchange) const {
    std::vector<RecordedPacket> wanted = exchange.answers;
    const bool is_end = wanted.size() == 3 && wanted[1].octets[1] == 0xc5;
    if (is_end && transcript_.name == "provision_unasked_oob") {
      wanted[1] = {{3, 0xc9, 0, 4}, std::vector<bool>(4, true)};
      wanted[2] = {{3, 0xc2, 0, 2}, std::vector<bool>(4, true)};
    }
    for (RecordedPacket& packet : wanted) {
      const std::uint8_t event = packet.octets[1];
      if (event == 0xc0) undefine(packet, 2, 16);          // UUID
      if (event == 0xc5) undefine(packet, 13, 16);         // device key
      if (event == ecdh_request) undefine(packet, 3, 64);  // the device's public key
      const bool is_own_pair = transcript_.name.starts_with("provision_wrong") ||
                               transcript_.name == "provision_bad_choice" ||
                               transcript_.name == "provision_unasked_oob";
      if (event == ecdh_request && is_own_pair) undefine(packet, 67, 32);
    }
    return wanted;
  }

  static void undefine(RecordedPacket& packet, std::size_t first, std::size_t count) {
    for (std::size_t i = first; i < first + count; ++i) packet.is_defined[i] = false;
  }

  const Transcript& transcript_;
  std::string release_;
  MeshHost host_;
  Bytes uuid_;     ///< of the device, once it was heard
  Bytes request_;  ///< the last event that asked for a shared secret
};

TEST(ProvisioningReplay, GoesAsRecorded) {
  for (const std::string& release : test::releases_of("provisioning.txt")) {
    for (const Transcript& transcript : test::read_transcripts("provisioning.txt", release)) {
      ProvisioningReplay(transcript, release).run();
    }
  }
}

}  // namespace
}  // namespace slamgw::sim::ble
