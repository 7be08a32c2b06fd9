// SPDX-License-Identifier: Apache-2.0
// Starting and stopping robots through a boolean model: Bluetooth's Generic OnOff, or Nordic's
// older vendor model Simple OnOff; which of the two the robots have is a matter of configuration.
#pragma once

#include "adapters/ble_mesh_usb_cdc/access/opcode.hpp"
#include "adapters/ble_mesh_usb_cdc/settings.hpp"

namespace slamgw::ble {

inline constexpr Opcode generic_on_off_status = 0x8204;
inline constexpr Opcode simple_on_off_status = 0xc45900;

/// An acknowledged Set. `tid` is new for each command and the same for its repeats: receivers
/// drop a TID that they saw within 6 s.
Bytes encode_on_off_set(OnOffModel model, bool is_on, std::uint8_t tid);
/// The opcode that answers it.
Opcode on_off_status(OnOffModel model);

}  // namespace slamgw::ble
