// SPDX-License-Identifier: Apache-2.0
// Reads a number from text.
#pragma once

#include <charconv>
#include <concepts>
#include <optional>
#include <string_view>
#include <system_error>

namespace slamgw {

/// Reads the whole of `text` as a number, without a sign `+`. Returns nothing for other text, or a
/// number out of range.
template <std::integral T>
std::optional<T> parse_number(std::string_view text, int base = 10) {
  T number = 0;
  const char* const end = text.data() + text.size();
  const auto read = std::from_chars(text.data(), end, number, base);
  return read.ec == std::errc{} && read.ptr == end ? std::optional(number) : std::nullopt;
}

}  // namespace slamgw
