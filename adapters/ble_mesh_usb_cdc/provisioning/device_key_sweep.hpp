// SPDX-License-Identifier: Apache-2.0
// Empties the board's table of device keys before the first conversation with a node: keys that an
// earlier run left there have handles that no command reads, and a second Devkey Add for the same
// node is refused. Called by NodeConversations while none is under way.
#pragma once

#include <algorithm>
#include <optional>

#include "adapters/ble_mesh_usb_cdc/nordic/board_link.hpp"

namespace slamgw::ble {

class DeviceKeySweep {
 public:
  /// The command that the board should get now; nothing when all is done.
  std::optional<Bytes> command() const {
    if (!first_) return encode_command(CommandOpcode::appkey_count_max_get);
    if (!end_) return encode_command(CommandOpcode::devkey_count_max_get);
    if (next_ >= *end_) return std::nullopt;
    return encode_command(CommandOpcode::devkey_delete, next_);
  }
  /// Most deletions are refused, because nothing is there.
  void on_command_ended(const CommandEnded& ended) {
    ByteReader data(ended.data);
    const std::uint16_t count = std::min(data.read_u16_le(), max_keys);
    if (!first_) {  // handles of device keys follow those of application keys
      first_ = data.ok() ? count : stock_appkeys;
      next_ = *first_;
    } else if (!end_) {
      end_ = static_cast<std::uint16_t>(*first_ + (data.ok() ? count : stock_devkeys));
    } else {
      ++next_;
    }
  }
  bool is_done() const { return end_ && next_ >= *end_; }

 private:
  static constexpr std::uint16_t stock_appkeys = 8;
  static constexpr std::uint16_t stock_devkeys = 10;
  static constexpr std::uint16_t max_keys = 64;

  std::optional<std::uint16_t> first_;
  std::optional<std::uint16_t> end_;
  std::uint16_t next_ = 0;
};

}  // namespace slamgw::ble
