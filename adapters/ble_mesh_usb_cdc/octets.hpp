// SPDX-License-Identifier: Apache-2.0
// Values as octets, little-endian: the parameters of access messages and of serial commands.
#pragma once

#include <cstdint>
#include <type_traits>

#include "daemon/core/bytes.hpp"

namespace slamgw::ble {

/// Returns these values one after the other: numbers in their type's size, octets unchanged.
template <class... Values>
Bytes octets_of(const Values&... values) {
  ByteWriter out;
  [[maybe_unused]] const auto write = [&out](const auto& value) {
    using Value = std::decay_t<decltype(value)>;
    if constexpr (std::is_same_v<Value, std::uint8_t>) {
      out.write_u8(value);
    } else if constexpr (std::is_same_v<Value, std::uint16_t>) {
      out.write_u16_le(value);
    } else if constexpr (std::is_same_v<Value, std::uint32_t>) {
      out.write_u32_le(value);
    } else {
      out.write(ByteView(value));
    }
  };
  (write(values), ...);
  return out.take();
}

}  // namespace slamgw::ble
