// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/firmware.hpp"

namespace slamgw::sim::ble {

const Firmware firmware_2_2_0{.release = "2.2.0",
                              .serial_version = 8,
                              .has_friendship_octet = false,
                              .has_attention_octet = false,
                              .has_tokens = false,
                              .checks_link_before_size = true,
                              .checks_static_oob_size = true,
                              .has_config_server_bind = false,
                              .has_heartbeats = false,
                              .has_network_state = false,
                              .clears_replay_list = false,
                              .asserts_on_publication_ttl = true,
                              .first_heartbeat_waits = true};

const Firmware firmware_3_1_0{.release = "3.1.0",
                              .serial_version = 10,
                              .has_friendship_octet = true,
                              .has_attention_octet = true,
                              .has_tokens = true,
                              .checks_link_before_size = false,
                              .checks_static_oob_size = true,
                              .has_config_server_bind = false,
                              .has_heartbeats = false,
                              .has_network_state = false,
                              .clears_replay_list = false,
                              .asserts_on_publication_ttl = true,
                              .first_heartbeat_waits = false};

const Firmware firmware_5_0_0{.release = "5.0.0",
                              .serial_version = 10,
                              .has_friendship_octet = true,
                              .has_attention_octet = true,
                              .has_tokens = true,
                              .checks_link_before_size = false,
                              .checks_static_oob_size = false,
                              .has_config_server_bind = true,
                              .has_heartbeats = true,
                              .has_network_state = true,
                              .clears_replay_list = true,
                              .asserts_on_publication_ttl = false,
                              .first_heartbeat_waits = false};

const Firmware* find_firmware(std::string_view release) {
  for (const Firmware* firmware : {&firmware_2_2_0, &firmware_3_1_0, &firmware_5_0_0}) {
    if (firmware->release == release) return firmware;
  }
  return nullptr;
}

}  // namespace slamgw::sim::ble
