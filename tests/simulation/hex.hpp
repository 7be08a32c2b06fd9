// SPDX-License-Identifier: Apache-2.0
// Bytes written as the references print them: hex octets, with or without spaces.
#pragma once

#include <string>
#include <string_view>

#include "simulation/bytes.hpp"

namespace slamgw::sim {

inline Bytes hex(std::string_view text) {
  std::string digits;
  for (const char c : text) {
    if (c != ' ') digits += c;
  }
  Bytes out;
  for (std::size_t i = 0; i + 1 < digits.size(); i += 2) {
    out.push_back(static_cast<std::uint8_t>(std::stoul(digits.substr(i, 2), nullptr, 16)));
  }
  return out;
}

inline std::string to_hex(ByteView bytes) {
  static constexpr char hex_digits[] = "0123456789abcdef";
  std::string out;
  for (const std::uint8_t octet : bytes) {
    if (!out.empty()) out += ' ';
    out += hex_digits[octet >> 4];
    out += hex_digits[octet & 15];
  }
  return out;
}

}  // namespace slamgw::sim
