// SPDX-License-Identifier: Apache-2.0
// What Nordic's serial board reports to its host: one event per frame. Opcodes that the daemon does
// not use come out as OtherEvent, never as errors; firmware newer than this file must not look
// broken. Octets that the daemon has no use for are left out. Called by BoardLink with what
// FrameDecoder found.
#pragma once

#include <cstdint>
#include <string_view>
#include <variant>

#include "adapters/ble_mesh_usb_cdc/errors.hpp"
#include "adapters/ble_mesh_usb_cdc/nordic/commands.hpp"
#include "daemon/core/bytes.hpp"
#include "daemon/core/result.hpp"

namespace slamgw::ble {

/// 0x81, the first event after every reset of the board.
struct DeviceStarted {
  std::uint8_t hardware_error = 0;
};

/// 0x82
struct EchoResponse {};

/// The status octet of 0x84; codes outside this list stay as they came.
enum class Status : std::uint8_t {
  success = 0x00,
  unknown_error = 0x80,
  internal = 0x81,  ///< Subnet and Appkey Add: the index already holds this very key
  command_unknown = 0x82,
  invalid_state = 0x83,  ///< Packet Send: a segmented message to there is still in progress
  invalid_length = 0x84,
  invalid_parameter = 0x85,
  busy = 0x86,
  invalid_data = 0x87,
  rejected = 0x8e,  ///< table full, unknown handle, or the index holds another key
  timeout = 0x93,
  invalid_key_data = 0x98,
};
std::string_view to_string(Status status);

/// 0x84. `data` is empty unless `status` is success.
struct CommandResponse {
  std::uint8_t opcode = 0;
  Status status = Status::success;
  Bytes data;
};

/// 0xd2
struct TxComplete {};

/// Any other opcode; its parameters are not kept.
struct OtherEvent {
  std::uint8_t opcode = 0;
};

// What the board reports while it scans for new devices and provisions one. A context is one of its
// two provisioning links.

/// 0xc1
struct ProvisioningLinkOpened {
  std::uint8_t context = 0;
};
/// 0xc2; the context is free again.
struct ProvisioningLinkClosed {
  std::uint8_t context = 0;
  /// 0 success, 1 time-out, 2 failed (Mesh Profile 1.0 section 5.3.1.4.3)
  std::uint8_t reason = 0;
};
/// 0xc3
struct CapabilitiesReceived {
  std::uint8_t context = 0;
  std::uint8_t elements = 0;
  std::uint8_t static_oob_types = 0;  ///< bit 0: the device has static OOB data
};
/// 0xc5. Carries a device key: never printed.
struct ProvisioningComplete {
  std::uint8_t context = 0;
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

/// The words of the mesh among them: beacon 0xc0, MessageReceived 0xd0 and 0xd1 (at most 235 octets
/// of payload), IvUpdate 0xd3, Heartbeat 0xd8 (firmware 4.0 and newer).
using Event = std::variant<DeviceStarted, EchoResponse, CommandResponse, MessageReceived,
                           TxComplete, IvUpdate, Heartbeat, ProvisioningEvent, OtherEvent>;

/// `frame` is opcode and parameters, as FrameDecoder leaves them.
Result<Event, DecodeError> decode_event(ByteView frame);

}  // namespace slamgw::ble
