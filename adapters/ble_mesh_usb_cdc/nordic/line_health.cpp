// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/nordic/line_health.hpp"

#include <fmt/format.h>

namespace slamgw::ble {

void LineHealth::on_port_open() {
  losses_ = 0;
  has_lost_step_ = false;
  timeouts_ = 0;
}

void LineHealth::on_lost_step(TimePoint now) {
  has_lost_step_ = true;
  count(now);
}

void LineHealth::on_timeout(std::uint8_t opcode, TimePoint now) {
  timeouts_ = opcode == silent_opcode_ ? timeouts_ + 1 : 1;
  silent_opcode_ = opcode;
  count(now);
}

void LineHealth::on_answer(std::uint8_t opcode) {
  if (opcode == silent_opcode_) timeouts_ = 0;
}

void LineHealth::count(TimePoint now) {
  if (now >= stable_at()) losses_ = 0;
  ++losses_;
  last_loss_ = now;
}

std::optional<std::string> LineHealth::verdict() const {
  if (timeouts_ >= max_timeouts && !has_lost_step_)
    return fmt::format(
        "the serial board answers Echo but not command 0x{:02x}: either the serial line loses "
        "octets (check the cable, the USB hub and ble_mesh.flow_control), or the firmware is not "
        "Nordic's serial example",
        silent_opcode_);
  if (timeouts_ >= max_timeouts || losses_ >= max_losses)
    return "octets are lost or added on the serial line to the board: check the cable, the USB hub "
           "and its power supply, ble_mesh.flow_control, and that no other program uses the port";
  return std::nullopt;
}

}  // namespace slamgw::ble
