// SPDX-License-Identifier: Apache-2.0
// The errors of this adapter's Results.
#pragma once

#include <cstdint>
#include <string>

namespace slamgw::ble {

/// Why bytes from the radio, the mesh or a file could not be read. The caller counts it.
enum class DecodeError : std::uint8_t {
  too_short,     ///< ends inside a field
  wrong_length,  ///< longer than its kind allows
  bad_value,     ///< a field holds what the specification forbids
};

/// Why something was not done, as a sentence for the operator.
struct Refusal {
  std::string why;
};

}  // namespace slamgw::ble
