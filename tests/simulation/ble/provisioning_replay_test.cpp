// SPDX-License-Identifier: Apache-2.0
// The simulated board provisions a simulated device as Nordic's board did in each release.
#include <gtest/gtest.h>

#include "tests/simulation/ble/replay_host.hpp"

namespace slamgw::sim::ble {
namespace {

using std::chrono::milliseconds;
using test::Exchange;
using test::RecordedPacket;
using test::Transcript;

constexpr milliseconds beacon_time{1100};  // a device beacons each second
constexpr std::size_t private_key_in_ecdh_request = 67;

BleOptions options_for(const Transcript& transcript, const std::string& release) {
  BleOptions options = MeshHost::unprovisioned();
  options.firmware = find_firmware(release);
  const bool has_oob = transcript.name == "provision_static_oob" ||
                       transcript.name == "provision_wrong_oob" ||
                       transcript.name == "provision_bad_choice";
  if (has_oob) options.static_oob = hex("6e6f726469635f6578616d706c655f31");  // "nordic_example_1"
  return options;
}

/// Returns true for transcripts in which the host sets no key pair, as the board has made one.
bool has_board_key_pair(const Transcript& transcript) {
  return transcript.name == "provision_wrong_oob" || transcript.name == "provision_bad_choice" ||
         transcript.name == "provision_unasked_oob";
}

/// Returns true if the recorded device uses a static OOB that it has not offered; a simulated
/// device has none, and fails.
bool ends_otherwise(const Transcript& transcript, const Exchange& exchange) {
  return transcript.name == "provision_unasked_oob" && exchange.answers.size() == 3 &&
         exchange.answers[1].octets[1] == 0xc5;
}

std::vector<RecordedPacket> wanted_of(const Transcript& transcript, const Exchange& exchange) {
  std::vector<RecordedPacket> wanted;
  for (const RecordedPacket& packet : exchange.answers) {
    wanted.push_back(ReplayHost::without_device(packet));
    if (packet.octets[1] == 0xc7 && has_board_key_pair(transcript)) {
      undefine(wanted.back(), private_key_in_ecdh_request, sizeof(PrivateKey));
    }
  }
  if (ends_otherwise(transcript, exchange)) {
    wanted[1] = {{3, 0xc9, 0, 4}, std::vector<bool>(4, true)};
    wanted[2] = {{3, 0xc2, 0, 2}, std::vector<bool>(4, true)};
  }
  return wanted;
}

void replay_provisioning(const Transcript& transcript, const std::string& release) {
  ReplayHost host(options_for(transcript, release));
  for (const Exchange& exchange : transcript.exchanges) {
    const std::vector<Bytes> answers = host.answers_to(exchange.command, beacon_time);
    const std::vector<RecordedPacket> wanted = wanted_of(transcript, exchange);
    SCOPED_TRACE(release + " " + transcript.name + ", line " + std::to_string(exchange.line) +
                 ": " + exchange.situation);
    ASSERT_EQ(wanted.size(), answers.size());
    for (std::size_t i = 0; i < answers.size(); ++i) {
      EXPECT_TRUE(wanted[i].matches(answers[i]))
          << "recorded  " << wanted[i].text() << "\nsimulated " << to_hex(answers[i]);
    }
  }
}

TEST(ProvisioningReplay, AnswersAsRecorded) {
  for (const std::string& release : test::releases_of("provisioning.txt")) {
    for (const Transcript& transcript : test::read_transcripts("provisioning.txt", release)) {
      replay_provisioning(transcript, release);
    }
  }
}

}  // namespace
}  // namespace slamgw::sim::ble
