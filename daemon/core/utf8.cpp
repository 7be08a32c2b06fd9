// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/utf8.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <optional>

namespace slamgw {
namespace {

constexpr std::size_t max_mqtt_text_octets = 65535;  // MQTT's two-octet length

struct Lead {
  int continuation_octets;
  std::uint32_t bits;
  std::uint32_t smallest;  // what needs this length, to refuse overlong forms
};

bool read_lead(std::uint8_t octet, Lead& lead) {
  if (octet < 0x80) return lead = {0, octet, 0}, true;
  if ((octet & 0xe0) == 0xc0) return lead = {1, octet & 0x1fu, 0x80}, true;
  if ((octet & 0xf0) == 0xe0) return lead = {2, octet & 0x0fu, 0x800}, true;
  if ((octet & 0xf8) == 0xf0) return lead = {3, octet & 0x07u, 0x10000}, true;
  return false;
}

/// Takes the first code point off `rest`, which is not empty; nothing where it is not well formed.
std::optional<std::uint32_t> take_code_point(std::string_view& rest) {
  Lead lead{};
  if (!read_lead(static_cast<std::uint8_t>(rest[0]), lead)) return std::nullopt;
  const auto length = static_cast<std::size_t>(lead.continuation_octets) + 1;
  if (rest.size() < length) return std::nullopt;
  std::uint32_t code_point = lead.bits;
  for (const char c : rest.substr(1, length - 1)) {
    const auto octet = static_cast<std::uint8_t>(c);
    if ((octet & 0xc0) != 0x80) return std::nullopt;
    code_point = code_point << 6 | (octet & 0x3fu);
  }
  const bool is_surrogate = code_point >= 0xd800 && code_point <= 0xdfff;
  if (code_point < lead.smallest || is_surrogate || code_point > 0x10ffff) return std::nullopt;
  rest.remove_prefix(length);
  return code_point;
}

/// Takes the printable ASCII off the front, which is all of nearly every text, and returns it.
std::string_view take_plain(std::string_view& text) {
  const auto end = std::ranges::find_if(text, [](char c) {
    const auto octet = static_cast<std::uint8_t>(c);
    return octet < 0x20 || octet > 0x7e;
  });
  const std::string_view plain(text.begin(), end);
  text.remove_prefix(plain.size());
  return plain;
}

bool is_control(std::uint32_t code_point) {
  return code_point <= 0x1f || (code_point >= 0x7f && code_point <= 0x9f);
}

bool is_non_character(std::uint32_t code_point) {
  return (code_point >= 0xfdd0 && code_point <= 0xfdef) || (code_point & 0xfffe) == 0xfffe;
}

struct Range {
  std::uint32_t first;
  std::uint32_t last;
};

bool is_hidden(std::uint32_t code_point) {
  constexpr Range hidden[] = {
      {0x61c, 0x61c}, {0x200e, 0x200f}, {0x2028, 0x2029}, {0x202a, 0x202e}, {0x2066, 0x2069}};
  return std::ranges::any_of(hidden, [code_point](const Range& range) {
    return code_point >= range.first && code_point <= range.last;
  });
}

}  // namespace

bool is_printable(std::string_view text) {
  while (take_plain(text), !text.empty()) {
    const auto code_point = take_code_point(text);
    if (!code_point || is_control(*code_point) || is_hidden(*code_point)) return false;
  }
  return true;
}

std::string escape_unprintable(std::string_view text) {
  std::string out;
  out.reserve(text.size());
  while (out += take_plain(text), !text.empty()) {
    std::string_view rest = text;
    const auto code_point = take_code_point(rest);
    if (!code_point || *code_point < 0x20) {
      out += fmt::format("\\x{:02x}", static_cast<std::uint8_t>(text[0]));
      text.remove_prefix(1);
      continue;
    }
    if (is_control(*code_point) || is_hidden(*code_point)) {
      out += fmt::format("\\u{:04x}", *code_point);
    } else {
      out += text.substr(0, text.size() - rest.size());
    }
    text = rest;
  }
  return out;
}

bool is_utf8(std::string_view text) {
  while (take_plain(text), !text.empty()) {
    if (!take_code_point(text)) return false;
  }
  return true;
}

bool is_mqtt_text(std::string_view text) {
  if (text.size() > max_mqtt_text_octets) return false;
  while (take_plain(text), !text.empty()) {
    const auto code_point = take_code_point(text);
    if (!code_point || is_control(*code_point) || is_non_character(*code_point)) return false;
  }
  return true;
}

}  // namespace slamgw
