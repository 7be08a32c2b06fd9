// SPDX-License-Identifier: Apache-2.0
// The errors of this adapter's Results.
#pragma once

#include <cstdint>
#include <string>

namespace slamgw::ble {

/// The reason why bytes from radio, mesh or file could not be decoded. The caller counts it.
enum class DecodeError : std::uint8_t {
  too_short,     ///< ends inside a field
  wrong_length,  ///< longer than this kind of value allows
  bad_value,     ///< a field holds what the specification forbids
};

/// The reason for a refusal, as a sentence for the operator.
struct Refusal {
  std::string why;
};

}  // namespace slamgw::ble
