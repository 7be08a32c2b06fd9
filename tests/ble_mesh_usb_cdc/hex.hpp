// SPDX-License-Identifier: Apache-2.0
// Byte vectors as the specification prints them.
#pragma once

#include <string_view>

#include "daemon/core/bytes.hpp"

namespace slamgw::ble {

/// Parses hex such as "03 02 68 69"; spaces are optional.
inline Bytes hex(std::string_view text) {
  const auto digit = [](char c) { return c <= '9' ? c - '0' : c - 'a' + 10; };
  Bytes bytes;
  bool is_high = true;
  for (const char c : text) {
    if (c == ' ') continue;
    if (is_high) {
      bytes.push_back(static_cast<std::uint8_t>(digit(c) << 4));
    } else {
      bytes.back() = static_cast<std::uint8_t>(bytes.back() | digit(c));
    }
    is_high = !is_high;
  }
  return bytes;
}

inline Bytes operator+(Bytes left, ByteView right) {
  left.insert(left.end(), right.begin(), right.end());
  return left;
}

}  // namespace slamgw::ble
