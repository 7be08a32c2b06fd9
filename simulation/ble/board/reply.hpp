// SPDX-License-Identifier: Apache-2.0
// What a command of the host gets: a status code of Nordic's serial protocol and data, which is
// sent on success only.
#pragma once

#include <cstdint>

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
  Bytes data;
};

}  // namespace slamgw::sim::ble
