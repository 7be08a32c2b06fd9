// SPDX-License-Identifier: Apache-2.0
// What the serial board tells while it scans for new devices and provisions one (0xc0-0xc9). A
// context is one of the board's two provisioning links. ProvisioningComplete carries a device key:
// never printed. Called by decode_event; read by Provisioner and ProvisioningSession.
#pragma once

#include <array>
#include <cstdint>
#include <variant>

#include "adapters/ble_mesh_usb_cdc/decode_error.hpp"
#include "adapters/ble_mesh_usb_cdc/nordic/commands.hpp"
#include "daemon/core/result.hpp"

namespace slamgw::ble {

/// The two coordinates of a point on P-256, X before Y, each most significant octet first.
using PublicKey = std::array<std::uint8_t, 64>;

/// 0xc0: a device that is in no mesh says so.
struct UnprovisionedBeacon {
  Uuid uuid{};
  std::int8_t rssi_dbm = 0;
};
/// 0xc1
struct ProvisioningLinkOpened {
  std::uint8_t context = 0;
};
/// 0xc2; the context is free again.
struct ProvisioningLinkClosed {
  std::uint8_t context = 0;
  std::uint8_t reason =
      0;  ///< 0 success, 1 time-out, 2 failed (Mesh Profile 1.0 section 5.3.1.4.3)
};
/// 0xc3
struct CapabilitiesReceived {
  std::uint8_t context = 0;
  std::uint8_t elements = 0;
  std::uint8_t static_oob_types = 0;  ///< bit 0: the device has static OOB data
};
/// 0xc5
struct ProvisioningComplete {
  std::uint8_t context = 0;
  std::uint16_t address = 0;
  Key device_key{};
};
/// 0xc6
struct AuthenticationRequested {
  std::uint8_t context = 0;
  std::uint8_t method = 0;  ///< 1: static OOB
};
/// 0xc7: the board leaves the Diffie-Hellman exchange to its host.
struct EcdhRequested {
  std::uint8_t context = 0;
  PublicKey peer{};
};
/// 0xc9
struct ProvisioningFailed {
  std::uint8_t context = 0;
  std::uint8_t error = 0;  ///< Mesh Profile 1.0 section 5.4.1.10
};

using ProvisioningEvent =
    std::variant<UnprovisionedBeacon, ProvisioningLinkOpened, ProvisioningLinkClosed,
                 CapabilitiesReceived, ProvisioningComplete, AuthenticationRequested, EcdhRequested,
                 ProvisioningFailed>;

bool is_provisioning_event(std::uint8_t opcode);
/// `frame` is opcode and parameters; `is_provisioning_event` holds for the opcode.
Result<ProvisioningEvent, DecodeError> decode_provisioning_event(ByteView frame);

}  // namespace slamgw::ble
