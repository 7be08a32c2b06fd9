// SPDX-License-Identifier: Apache-2.0
// One command to a robot, as it goes over the mesh: made from a broker message under
// `<prefix>/server/<id>/<type>`, or refused with a reason for the operator. Called by Downlink.
#pragma once

#include <string>
#include <string_view>

#include "adapters/ble_mesh_usb_cdc/access/opcode.hpp"
#include "adapters/ble_mesh_usb_cdc/errors.hpp"
#include "adapters/ble_mesh_usb_cdc/settings.hpp"
#include "daemon/core/messages.hpp"

namespace slamgw::ble {

struct Command {
  CommandId id = CommandId::none;
  std::string type;
  Bytes access;                 ///< the acknowledged message to send, opcode first
  Opcode awaited_status = 0;    ///< what the robot answers when it has it
  bool is_replaceable = false;  ///< a newer one makes it pointless: positions
  BrokerMessage message{};      ///< that it was made from
};

/// `settings.pos_cmd_type` becomes pos_cmd SET and takes 4 octets, x and y as little-endian int16
/// in centimetres; `run` becomes an on/off Set; any other type is carried unread in min_com SET.
/// The error says why not. `tid`: see encode_on_off_set.
Result<Command, Refusal> make_command(const Settings& settings, std::string_view type,
                                      ByteView payload, std::uint8_t tid);

}  // namespace slamgw::ble
