// SPDX-License-Identifier: Apache-2.0
#include "ctl/payload.hpp"

#include <charconv>
#include <optional>

#include "daemon/control/wire.hpp"

namespace slamgw::ctl {
namespace {

std::optional<std::int16_t> parse_coordinate(std::string_view text) {
  if (text.starts_with('+')) text.remove_prefix(1);
  std::int16_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{} || end != text.data() + text.size()) return std::nullopt;
  return value;
}

}  // namespace

Result<Bytes, std::string> parse_payload(std::string_view type, std::string_view text,
                                         bool is_hex) {
  if (is_hex) {
    auto bytes = control::parse_hex(text);
    if (!bytes) return std::string("with --hex it is pairs of hex digits, like 0a00ecff");
    return std::move(*bytes);
  }
  if (type != "cmd") return to_bytes(text);
  const std::size_t comma = text.find(',');
  const auto x = parse_coordinate(text.substr(0, comma));
  const auto y = comma == text.npos ? std::nullopt : parse_coordinate(text.substr(comma + 1));
  if (!x || !y) {
    return std::string(
        "for cmd it is X,Y (each -32768 to 32767 cm), like 120,-33; other bytes with --hex");
  }
  return ByteWriter().write_i16_le(*x).write_i16_le(*y).take();
}

}  // namespace slamgw::ctl
