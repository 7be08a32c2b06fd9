// SPDX-License-Identifier: Apache-2.0
// The commands for the board itself: version, UUID, counters, its advertiser, and those for models
// on the board and firmware update, of which only the length is checked.
#pragma once

#include <array>

#include "simulation/ble/access.hpp"
#include "simulation/ble/board/board_flash.hpp"
#include "simulation/ble/board/reply.hpp"
#include "simulation/ble/board/transmit_buffer.hpp"
#include "simulation/ble/firmware.hpp"

namespace slamgw::sim::ble {

class DeviceCommands {
 public:
  /// All three must outlive this object.
  DeviceCommands(const Firmware& firmware, const BoardFlash& flash, TransmitBuffer& to_host)
      : firmware_(firmware), flash_(flash), to_host_(to_host) {
    reset();
  }

  /// Returns nothing for other commands.
  std::optional<Reply> on_command(std::uint8_t opcode, ByteView params);
  /// The UUID and the advertiser's settings are in RAM.
  void reset();

 private:
  Reply serial_version(ByteView);
  Reply beacon_start(ByteView params);
  Reply beacon_stop(ByteView params);
  Reply beacon_params_set(ByteView params);
  Reply beacon_params_get(ByteView params);
  Reply housekeeping_get(ByteView);
  Reply housekeeping_clear(ByteView);
  Reply refuse(ByteView);
  Reply advertising_address(ByteView);
  Reply uuid_set(ByteView params);
  Reply uuid_get(ByteView);
  Reply network_state(ByteView);

  const Firmware& firmware_;
  const BoardFlash& flash_;
  TransmitBuffer& to_host_;
  Key uuid_{};
  /// TX power, channel map and interval in milliseconds as set by the host; without effect.
  std::array<std::uint8_t, 6> beacon_params_{};
};

}  // namespace slamgw::sim::ble
