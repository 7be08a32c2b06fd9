// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/board/device_commands.hpp"

#include <algorithm>

namespace slamgw::sim::ble {
namespace {

constexpr Key factory_uuid{0x5c, 0x1a, 0x6e, 0x00, 0x11, 0x22, 0x33, 0x44,
                           0x55, 0x66, 0x77, 0x88, 0x99, 0xaa, 0xbb, 0x01};
constexpr std::uint8_t beacon_slots = 1;
constexpr std::uint8_t max_params = 254;

bool has_slot(ByteView params) { return params[0] < beacon_slots; }

}  // namespace

void DeviceCommands::reset() {
  uuid_ = factory_uuid;
  beacon_params_ = {};
}

std::optional<Reply> DeviceCommands::on_command(std::uint8_t opcode, ByteView params) {
  using Self = DeviceCommands;
  static constexpr Command<Self> commands[] = {
      {0x09, 0, 0, &Self::serial_version},
      {0x10, 1, 32, &Self::beacon_start},
      {0x11, 1, 1, &Self::beacon_stop},
      {0x12, 7, 7, &Self::beacon_params_set},
      {0x13, 1, 1, &Self::beacon_params_get},
      {0x14, 0, 0, &Self::housekeeping_get},
      {0x15, 0, 0, &Self::housekeeping_clear},
      {0x20, 0, max_params, &Self::refuse},  // the stock example has no application
      {0x41, 0, 0, &Self::advertising_address},
      {0x53, 16, 16, &Self::uuid_set},
      {0x54, 0, 0, &Self::uuid_get},
      // Firmware update, and models on the board: nothing can be found.
      {0xd1, 1, max_params, &Self::refuse},
      {0xd4, 1, max_params, &Self::refuse},
      {0xe0, 1, max_params, &Self::refuse},
      {0xe2, 1, max_params, &Self::refuse},
      {0xe4, 1, max_params, &Self::refuse},
      {0xe7, 1, max_params, &Self::refuse},
      {0xee, 1, max_params, &Self::refuse},
      {0xf3, 1, max_params, &Self::refuse},
      {0xfd, 1, max_params, &Self::refuse},
      {0xfe, 1, max_params, &Self::refuse},
  };
  static constexpr Command<Self> config_server_commands[] = {{0xad, 2, 2, &Self::refuse}};
  static constexpr Command<Self> network_state_commands[] = {
      {0xaf, 0, 0, &Self::network_state},
  };
  std::optional<Reply> reply = run_command(commands, *this, opcode, params);
  if (!reply && firmware_.has_config_server_bind) {
    reply = run_command(config_server_commands, *this, opcode, params);
  }
  if (!reply && firmware_.has_network_state) {
    reply = run_command(network_state_commands, *this, opcode, params);
  }
  return reply;
}

Reply DeviceCommands::serial_version(ByteView) { return reply_with(firmware_.serial_version); }

Reply DeviceCommands::beacon_start(ByteView params) {
  return {has_slot(params) ? Status::success : Status::invalid_parameter};
}

Reply DeviceCommands::beacon_stop(ByteView params) {
  return {has_slot(params) ? Status::success : Status::invalid_parameter};
}

Reply DeviceCommands::beacon_params_set(ByteView params) {
  if (!has_slot(params)) return {Status::invalid_parameter};
  std::copy_n(params.begin() + 1, beacon_params_.size(), beacon_params_.begin());
  return {};
}

Reply DeviceCommands::beacon_params_get(ByteView params) {
  if (!has_slot(params)) return {Status::invalid_parameter};
  Bytes data{params[0]};
  put(data, beacon_params_);
  return {Status::success, data};
}

Reply DeviceCommands::housekeeping_get(ByteView) {
  Reply reply;
  put_u32_le(reply.data, to_host_.dropped());
  return reply;
}

Reply DeviceCommands::housekeeping_clear(ByteView) {
  to_host_.clear_dropped();
  return {};
}

Reply DeviceCommands::refuse(ByteView) { return {Status::rejected}; }

/// Random static, least significant octet first.
Reply DeviceCommands::advertising_address(ByteView) {
  return {Status::success, {0x01, 0x00, 0x00, 0xf9, 0x0b, 0x6e, 0xc1}};
}

Reply DeviceCommands::uuid_set(ByteView params) {
  std::copy(params.begin(), params.end(), uuid_.begin());
  return {};
}

Reply DeviceCommands::uuid_get(ByteView) {
  return {Status::success, Bytes(uuid_.begin(), uuid_.end())};
}

/// IV index, IV update flag and its timer, then the sequence number.
Reply DeviceCommands::network_state(ByteView) {
  Reply reply;
  reply.data.resize(7);
  put_u32_le(reply.data, flash_.reserved_sequence);
  return reply;
}

}  // namespace slamgw::sim::ble
