// SPDX-License-Identifier: Apache-2.0
// Why bytes from the board, the mesh or a file could not be read. The caller counts it.
#pragma once

#include <cstdint>

namespace slamgw::ble {

enum class DecodeError : std::uint8_t {
  too_short,     ///< ends inside a field
  wrong_length,  ///< longer than its kind allows
  bad_value,     ///< a field holds what the specification forbids
};

}  // namespace slamgw::ble
