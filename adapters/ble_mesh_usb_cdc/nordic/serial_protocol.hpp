// SPDX-License-Identifier: Apache-2.0
// Nordic's serial protocol (versions 5 to 10): its frames, the commands that the daemon sends, and
// the events that the board reports. Multi-byte numbers are little-endian on the wire, keys most
// significant octet first. Called by everything in nordic/.
#pragma once

#include <cstdint>
#include <optional>
#include <string_view>
#include <variant>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/errors.hpp"
#include "adapters/ble_mesh_usb_cdc/octets.hpp"
#include "adapters/ble_mesh_usb_cdc/radio.hpp"
#include "daemon/core/bytes.hpp"
#include "daemon/core/result.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::ble {

// Nordic's serial framing: `len opcode params`, where len counts opcode and params (1..255). There
// is no checksum and no delimiter. FrameDecoder only follows the borders and notices when they are
// lost; Resync finds them again.

inline constexpr std::size_t max_frame_params = 254;

/// Returns the frame as it is sent; `params` is at most `max_frame_params` octets.
Bytes encode_frame(std::uint8_t opcode, ByteView params);

class FrameDecoder {
 public:
  /// 255 octets take 22 ms at 115200 baud; a frame that takes longer than this is torn.
  static constexpr Duration max_partial_age = std::chrono::milliseconds{250};

  /// Returns the frames that `bytes` completes: opcode first, without length octet, never empty.
  std::vector<Bytes> on_bytes(ByteView bytes, TimePoint now);
  /// Returns true after a zero length or a torn frame. Everything is ignored then until `reset()`.
  bool has_lost_step() const { return has_lost_step_; }
  void reset();

  std::optional<TimePoint> deadline() const;
  void on_deadline(TimePoint now);

 private:
  Bytes partial_;  ///< length octet first; at most 256 octets
  TimePoint partial_since_{};
  bool has_lost_step_ = false;
};

enum class CommandOpcode : std::uint8_t {
  echo = 0x02,
  serial_version_get = 0x09,
  radio_reset = 0x0e,  ///< no response: the board restarts and says so (0x81)
  housekeeping_get = 0x14,
  uuid_get = 0x54,
  scan_start = 0x61,
  scan_stop = 0x62,
  provision = 0x63,
  oob_use = 0x66,
  auth_data = 0x67,
  ecdh_secret = 0x68,
  keypair_set = 0x69,
  capabilities_set = 0x6a,
  enable = 0x90,
  subnet_add = 0x92,
  subnet_update = 0x93,  ///< a key refresh: hears the old and the new key, sends under the old
  subnet_get_all = 0x95,
  appkey_add = 0x97,
  appkey_update = 0x98,  ///< only during the refresh of its subnet
  appkey_get_all = 0x9a,
  appkey_count_max_get = 0x9b,
  devkey_add = 0x9c,
  devkey_delete = 0x9d,
  devkey_count_max_get = 0x9e,
  local_unicast_set = 0x9f,
  local_unicast_get = 0xa0,
  subscription_add = 0xa1,
  publication_add = 0xa4,
  publication_remove = 0xa6,
  address_get = 0xa7,
  address_get_all = 0xa8,
  packet_send = 0xab,
  state_clear = 0xac,  ///< also resets the sequence numbers: on an operator's word only
};

/// The two coordinates of a point on P-256, X before Y, each most significant octet first.
using PublicKey = std::array<std::uint8_t, 64>;
using SharedSecret = std::array<std::uint8_t, 32>;
struct KeyPair {
  std::array<std::uint8_t, 32> private_key{};
  PublicKey public_key{};
};

/// One access message to send (0xab).
struct PacketSend {
  std::uint16_t appkey_handle = 0;
  std::uint16_t source = 0;              ///< a local unicast address
  std::uint16_t destination_handle = 0;  ///< from 0xa4
  std::uint8_t ttl = 0;
  ByteView payload;  ///< access message, opcode first; at most `send_limit`
};

/// The firmware's answer to command 0x09. Packet Send and Provision differ between the versions.
/// Options of Packet Send that a version does not have would be sent before each message on air.
enum class SerialVersion : std::uint16_t {
  sdk_1_0 = 5,   ///< nRF5 SDK for Mesh 1.0.x
  sdk_2_0 = 6,   ///< 2.0.x, 2.1.x
  sdk_2_2 = 8,   ///< 2.2.0
  sdk_3_0 = 9,   ///< 3.0.0
  sdk_3_1 = 10,  ///< 3.1.0 to 5.0.0
};
/// Returns the releases with that version, such as "2.2"; empty for unknown versions.
std::string_view sdk_releases(SerialVersion version);
/// Returns the size of the longest access message that every firmware of this version sends: 244
/// octets, less for old versions.
std::size_t send_limit(SerialVersion version);

/// Returns a command with these parameters, written by octets_of().
template <class... Params>
Bytes encode_command(CommandOpcode opcode, const Params&... params) {
  return encode_frame(static_cast<std::uint8_t>(opcode), octets_of(params...));
}

Bytes encode_packet_send(const PacketSend& packet, SerialVersion version);

enum class OobMethod : std::uint8_t { none = 0, static_data = 1 };

/// Key index 0, no IV update and no key refresh in progress, no attention signal. `context`: one of
/// the board's two provisioning links.
Bytes encode_provision(std::uint8_t context, const ProvisionDevice& device, SerialVersion version);
/// The capabilities of the board as a device: one element, no OOB.
Bytes encode_capabilities_set();
Bytes encode_oob_use(std::uint8_t context, OobMethod method);

// The events of Nordic's serial board, one per frame. Opcodes that the daemon does not use become
// OtherEvent, never an error: firmware newer than this file must not look broken. Octets that the
// daemon does not use are left out. BoardLink decodes the frames of FrameDecoder.

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
  invalid_state = 0x83,  ///< Packet Send: still sends a segmented message to there
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
struct OtherEvent {};

// Events while the board scans for new devices and provisions one. A context is one of the board's
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
/// 0xc5. Carries keys: never printed.
struct ProvisioningComplete {
  std::uint8_t context = 0;
  std::uint16_t address = 0;  ///< of the device's first element
  Key device_key{};
  Key net_key{};
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

/// Types of radio.hpp among them: beacon 0xc0, MessageReceived 0xd0 and 0xd1 (at most 235 octets of
/// payload), IvUpdate 0xd3, Heartbeat 0xd8 (firmware 4.0 and newer).
using Event = std::variant<DeviceStarted, EchoResponse, CommandResponse, MessageReceived,
                           TxComplete, IvUpdate, Heartbeat, ProvisioningEvent, OtherEvent>;

/// `frame` is opcode and parameters, as FrameDecoder returns them.
Result<Event, DecodeError> decode_event(ByteView frame);

}  // namespace slamgw::ble
