// SPDX-License-Identifier: Apache-2.0
// The commands that take a new device into the mesh and hold its device key, as complete frames.
// Keys and UUIDs go most significant octet first. What the board answers:
// provisioning_events.hpp. Called by ProvisioningSession and NodeConfiguration.
#pragma once

#include "adapters/ble_mesh_usb_cdc/nordic/commands.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/ecdh.hpp"

namespace slamgw::ble {

/// 0x63. Key index 0, no IV update and no key refresh in progress, no attention signal.
struct ProvisionCommand {
  std::uint8_t context = 0;
  Uuid uuid{};
  Key net_key{};
  std::uint32_t iv_index = 0;
  std::uint16_t address = 0;  ///< of the device's first element
  SerialVersion version = SerialVersion::sdk_3_1;
};

enum class OobMethod : std::uint8_t { none = 0, static_data = 1 };

Bytes encode_provision(const ProvisionCommand& command);
Bytes encode_keypair_set(const KeyPair& pair);
/// What the board itself can do: one element, no OOB.
Bytes encode_capabilities_set();
Bytes encode_oob_use(std::uint8_t context, OobMethod method);
Bytes encode_auth_data(std::uint8_t context, const Key& static_oob);
Bytes encode_ecdh_secret(std::uint8_t context, const SharedSecret& secret);
Bytes encode_devkey_add(std::uint16_t owner, std::uint16_t subnet_handle, const Key& key);

}  // namespace slamgw::ble
