// SPDX-License-Identifier: Apache-2.0
// The commands for network, application and device keys (0x92 to 0x9e).
#pragma once

#include "simulation/ble/board/board_flash.hpp"
#include "simulation/ble/board/reply.hpp"

namespace slamgw::sim::ble {

class KeyCommands {
 public:
  /// `flash` must outlive this object.
  explicit KeyCommands(BoardFlash& flash) : flash_(flash) {}

  /// Returns nothing for other commands.
  std::optional<Reply> on_command(std::uint8_t opcode, ByteView params);

 private:
  Reply subnet_add(ByteView params);
  Reply subnet_update(ByteView params);
  Reply subnet_delete(ByteView params);
  Reply subnet_get_all(ByteView);
  Reply subnet_count_max(ByteView);
  Reply appkey_add(ByteView params);
  Reply appkey_update(ByteView params);
  Reply appkey_delete(ByteView params);
  Reply appkey_get_all(ByteView params);
  Reply appkey_count_max(ByteView);
  Reply devkey_add(ByteView params);
  Reply devkey_delete(ByteView params);
  Reply devkey_count_max(ByteView);

  BoardFlash& flash_;
};

}  // namespace slamgw::sim::ble
