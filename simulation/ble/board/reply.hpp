// SPDX-License-Identifier: Apache-2.0
// The reply to a command of the host: a status code of Nordic's serial protocol, and data, which
// are sent on success only. Each part of the board has a table of its commands.
#pragma once

#include <cstdint>
#include <optional>

#include "simulation/bytes.hpp"

namespace slamgw::sim::ble {

enum class Status : std::uint8_t {
  success = 0x00,
  internal = 0x81,
  command_unknown = 0x82,
  invalid_state = 0x83,
  invalid_length = 0x84,
  invalid_parameter = 0x85,
  invalid_data = 0x87,
  rejected = 0x8e,
};

struct Reply {
  Status status = Status::success;
  Bytes data{};
};

/// Success with two octets, the least significant first.
inline Reply reply_with(std::uint16_t value) {
  Reply reply;
  put_u16_le(reply.data, value);
  return reply;
}

/// A command of the part `Owner` of the board: the range of its parameters' size, and its function.
template <typename Owner>
struct Command {
  std::uint8_t opcode;
  std::uint8_t min_params;
  std::uint8_t max_params;
  Reply (Owner::*run)(ByteView params);
};

/// Returns nothing when `opcode` is not in the table.
template <typename Owner, std::size_t size>
std::optional<Reply> run_command(const Command<Owner> (&table)[size], Owner& owner,
                                 std::uint8_t opcode, ByteView params) {
  for (const Command<Owner>& command : table) {
    if (command.opcode != opcode) continue;
    const bool has_length =
        params.size() >= command.min_params && params.size() <= command.max_params;
    return has_length ? (owner.*command.run)(params) : Reply{Status::invalid_length};
  }
  return std::nullopt;
}

}  // namespace slamgw::sim::ble
