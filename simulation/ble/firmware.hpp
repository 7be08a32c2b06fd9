// SPDX-License-Identifier: Apache-2.0
// The releases of Nordic's nRF5 SDK for Mesh that board and robots can run, their differences
// (tests/vectors/nordic_board/README.md), and the variants of robots' own code.
#pragma once

#include <cstdint>
#include <string_view>

namespace slamgw::sim::ble {

struct Firmware {
  std::string_view release;
  std::uint16_t serial_version;     ///< command 0x09
  bool has_friendship_octet;        ///< in Packet Send; from 3.0.0
  bool has_attention_octet;         ///< in Provision; from 3.0.0
  bool has_tokens;                  ///< of sent packets, and TX Complete; from 3.1.0
  bool checks_link_before_size;     ///< of Auth Data; 2.2.0
  bool checks_static_oob_size;      ///< of OOB Use; up to 3.2.0
  bool has_config_server_bind;      ///< command 0xad; from 4.0.0
  bool has_heartbeats;              ///< event 0xd8; from 4.0.0
  bool has_network_state;           ///< commands 0xae, 0xaf; from 5.0.0
  bool clears_replay_list;          ///< with State Clear; from 5.0.0
  bool asserts_on_publication_ttl;  ///< robots, above 127; up to 4.2.0
  /// The first heartbeat of a robot waits for its next message; a second request before that fails
  /// an assertion. Robots count heartbeats in their models' groups only. Up to 3.0.0.
  bool first_heartbeat_waits;
};

extern const Firmware firmware_2_2_0;
extern const Firmware firmware_3_1_0;
extern const Firmware firmware_5_0_0;

/// Returns null for a release that cannot be simulated.
const Firmware* find_firmware(std::string_view release);

/// The treatment of an update while the robot's last SET waits for its STATUS.
enum class OnBusy : std::uint8_t {
  cancel,  ///< forgets the old one, and skips this update, too (thesis 9.1: "cancelled")
  refuse,  ///< drops this update; the old one is repeated until its STATUS (Nordic's access layer)
};

}  // namespace slamgw::sim::ble
