// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/robots/command.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <optional>

#include "adapters/ble_mesh_usb_cdc/access/robot_models.hpp"
#include "adapters/ble_mesh_usb_cdc/nordic/commands.hpp"

namespace slamgw::ble {
namespace {

constexpr std::string_view run_type = "run";
constexpr std::size_t position_bytes = 4;
constexpr std::size_t vendor_opcode_bytes = 3;
constexpr std::size_t max_payload_bytes = max_send_bytes - vendor_opcode_bytes;

std::optional<bool> parse_run(ByteView payload) {
  constexpr std::array<std::string_view, 4> on{"1", "on", "start", "unpause"};
  constexpr std::array<std::string_view, 4> off{"0", "off", "stop", "pause"};
  if (payload.size() == 1 && payload.front() <= 1) return payload.front() == 1;
  if (std::ranges::find(on, as_text(payload)) != on.end()) return true;
  if (std::ranges::find(off, as_text(payload)) != off.end()) return false;
  return std::nullopt;
}

Command vendor_command(std::string_view type, VendorModel model, ByteView payload) {
  return {.type = std::string(type),
          .access = encode_access(opcode_of({model, MessageKind::set}), payload),
          .awaited_status = opcode_of({model, MessageKind::status}),
          .is_replaceable = model == VendorModel::pos_cmd};
}

}  // namespace

Result<Command, Refusal> make_command(const Settings& settings, std::string_view type,
                                      ByteView payload, std::uint8_t tid) {
  if (type == settings.pos_cmd_type) {
    if (payload.size() == position_bytes)
      return vendor_command(type, VendorModel::pos_cmd, payload);
    return Refusal{fmt::format("{} takes 4 bytes (x and y, int16 little-endian, in cm), not {}",
                               type, payload.size())};
  }
  if (type == run_type) {
    const auto is_on = parse_run(payload);
    if (!is_on) return Refusal{"run takes 0, 1, off, on, stop, start, pause or unpause"};
    return Command{.type = std::string(type),
                   .access = encode_on_off_set(settings.on_off_model, *is_on, tid),
                   .awaited_status = on_off_status(settings.on_off_model),
                   .is_replaceable = false};
  }
  if (payload.size() > max_payload_bytes)
    return Refusal{fmt::format("{} bytes are too many: the serial board sends at most {}",
                               payload.size(), max_payload_bytes)};
  return vendor_command(type, VendorModel::min_com, payload);
}

}  // namespace slamgw::ble
