// SPDX-License-Identifier: Apache-2.0
// The thesis's three vendor models (thesis 5.2.1, tables 5.1 and 5.2): each has the four messages
// SET, GET, SET_UNRELIABLE and STATUS at consecutive vendor opcodes of company 0x0059. This gateway
// also hears a SET_NUMBERED of each, which the thesis does not have (README, "Robots").
#pragma once

#include <optional>

#include "adapters/ble_mesh_usb_cdc/access/opcode.hpp"

namespace slamgw::ble {

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
/// Nothing for opcodes of other models.
std::optional<VendorMessage> vendor_message_of(Opcode opcode);

/// A complete STATUS message: one state octet 00, as Nordic's models do it; then the transaction
/// number of the SET_NUMBERED that it answers.
Bytes encode_status(VendorModel model, std::optional<std::uint8_t> number = {});

}  // namespace slamgw::ble
