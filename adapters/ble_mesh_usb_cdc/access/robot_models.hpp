// SPDX-License-Identifier: Apache-2.0
// The messages that robots and the gateway exchange: those of the thesis's three vendor models, and
// on/off through a boolean model. The configuration says which boolean model the robots have:
// Bluetooth's Generic OnOff or Nordic's older Simple OnOff.
//
// The vendor models (thesis 5.2.1, tables 5.1 and 5.2) have the four messages SET, GET,
// SET_UNRELIABLE and STATUS each, at consecutive vendor opcodes of company 0x0059. This gateway
// also hears a SET_NUMBERED of each, which the thesis does not have (README, "Robots").
#pragma once

#include <cstdint>
#include <optional>

#include "adapters/ble_mesh_usb_cdc/errors.hpp"
#include "adapters/ble_mesh_usb_cdc/settings.hpp"
#include "daemon/core/bytes.hpp"
#include "daemon/core/result.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::ble {

// The head of an access message (Mesh Profile 1.0 section 3.7.3.1): an opcode of one, two or three
// octets, then parameters.

/// The opcode's octets as one number in wire order, the first most significant: 0x04, 0x8202,
/// 0xc95900 (vendor opcode c9 of company 0x0059, which goes little-endian over the air).
using Opcode = std::uint32_t;

struct AccessMessage {
  Opcode opcode = 0;
  ByteView params;  ///< a view into the decoded bytes
};

Result<AccessMessage, DecodeError> decode_access(ByteView payload);
Bytes encode_access(Opcode opcode, ByteView params);

/// Returns the number of segments that the message takes (Mesh Profile 1.0 section 3.5.2). It is
/// one if opcode and parameters fit in 11 octets. Otherwise each segment carries 12 octets, with a
/// 4-octet TransMIC at the end.
std::size_t segments_of(std::size_t access_bytes);

enum class VendorModel : std::uint8_t { min_com, sensor_update, pos_cmd };
inline constexpr std::size_t vendor_model_count = 3;

/// `set` is repeated by its sender until a `status` comes back; `set_unreliable` is sent once.
/// `set_numbered` is a `set` with a transaction number of one octet before its parameters, which
/// its repeats share; its `status` has the number after the state octet.
enum class MessageKind : std::uint8_t { set, get, set_unreliable, status, set_numbered };

struct VendorMessage {
  VendorModel model = VendorModel::min_com;
  MessageKind kind = MessageKind::set;
  bool operator==(const VendorMessage&) const = default;
};

Opcode opcode_of(VendorMessage message);
/// Returns nothing for opcodes of other models.
std::optional<VendorMessage> vendor_message_of(Opcode opcode);

/// A complete STATUS message: one state octet 00, as Nordic's models do it; then the transaction
/// number of the SET_NUMBERED that it answers.
Bytes encode_status(VendorModel model, std::optional<std::uint8_t> number = {});

/// SENSOR_UPDATE_RELAYED, which the thesis does not have either: a robot on another mesh has sent
/// `update`. `sender` is relayed_number_of() that robot.
Bytes encode_relayed_update(std::uint16_t sender, ByteView update);

inline constexpr Opcode generic_on_off_status = 0x8204;
inline constexpr Opcode simple_on_off_status = 0xc45900;

/// An acknowledged Set. `tid` is new for each command and the same for its repeats: receivers
/// drop a TID that they saw within 6 s.
Bytes encode_on_off_set(OnOffModel model, bool is_on, std::uint8_t tid);
/// Returns the opcode of the answer to encode_on_off_set().
Opcode on_off_status(OnOffModel model);

/// Returns iv, the interval of Nordic's reliable publish (access_reliable.h). An acknowledged
/// message is repeated iv, 2iv, 4iv, 8iv ... after its first transmission, until a STATUS comes
/// back. Robots do so towards the gateway, and the gateway towards robots. iv is 200 ms, plus 20 ms
/// for each hop that the TTL allows. A segmented message adds 20 ms for each segment.
Duration reliable_interval(std::uint8_t ttl, std::size_t access_bytes);

}  // namespace slamgw::ble
