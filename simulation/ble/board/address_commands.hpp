// SPDX-License-Identifier: Apache-2.0
// The commands for the board's own address and the addresses that it receives or sends to (0x9f to
// 0xaa).
#pragma once

#include "simulation/ble/board/board_flash.hpp"
#include "simulation/ble/board/reply.hpp"

namespace slamgw::sim::ble {

class AddressCommands {
 public:
  /// `flash` must outlive this object.
  explicit AddressCommands(BoardFlash& flash) : flash_(flash) {}

  /// Returns nothing for other commands.
  std::optional<Reply> on_command(std::uint8_t opcode, ByteView params);

 private:
  Reply local_unicast_set(ByteView params);
  Reply local_unicast_get(ByteView);
  Reply subscription_add(ByteView params);
  Reply subscription_add_virtual(ByteView params);
  Reply subscription_remove(ByteView params);
  Reply publication_add(ByteView params);
  Reply publication_add_virtual(ByteView params);
  Reply publication_remove(ByteView params);
  Reply address_get(ByteView params);
  Reply address_get_all(ByteView);
  Reply nonvirtual_count_max(ByteView);
  Reply virtual_count_max(ByteView);

  bool is_heard(const AddressTable::Slot& slot) const;

  BoardFlash& flash_;
};

}  // namespace slamgw::sim::ble
