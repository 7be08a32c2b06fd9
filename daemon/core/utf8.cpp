// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/utf8.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <boost/locale/utf.hpp>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>

namespace slamgw {
namespace {

constexpr std::size_t max_mqtt_text_octets = 65535;  // MQTT's two-octet length

/// Takes the first code point off `rest`, which must not be empty. Returns nothing, and takes
/// nothing, where `rest` is not well formed.
std::optional<std::uint32_t> take_code_point(std::string_view& rest) {
  auto end = rest.begin();
  const auto code_point = boost::locale::utf::utf_traits<char>::decode(end, rest.end());
  if (!boost::locale::utf::is_valid_codepoint(code_point)) return std::nullopt;
  rest.remove_prefix(static_cast<std::size_t>(end - rest.begin()));
  return code_point;
}

/// Takes the printable ASCII off the front of `text` and returns it. Nearly every text is printable
/// ASCII as a whole.
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

bool is_ascii_letter(char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z'); }

bool is_non_character(std::uint32_t code_point) {
  return (code_point >= 0xfdd0 && code_point <= 0xfdef) || (code_point & 0xfffe) == 0xfffe;
}

struct Range {
  std::uint32_t first;
  std::uint32_t last;
};

bool is_in(std::span<const Range> ranges, std::uint32_t code_point) {
  return std::ranges::any_of(ranges, [code_point](const Range& range) {
    return code_point >= range.first && code_point <= range.last;
  });
}

// web/page/shown.js and experiment/slamgw_experiment/events.py have the same three tables;
// tests/vectors/shown.json checks all three.

/// Characters without a width, or that turn the direction of the text after them.
constexpr Range hidden[] = {{0xad, 0xad},     {0x34f, 0x34f},   {0x61c, 0x61c},    {0x115f, 0x1160},
                            {0x17b4, 0x17b5}, {0x180b, 0x180f}, {0x200b, 0x200f},  {0x2028, 0x202e},
                            {0x2060, 0x206f}, {0x3164, 0x3164}, {0xfe00, 0xfe0f},  {0xfeff, 0xfeff},
                            {0xffa0, 0xffa0}, {0xfff9, 0xfffb}, {0xe0000, 0xe0fff}};

/// Characters out of place among Latin letters: Greek, Cyrillic and other alphabets with
/// look-alikes, marks, spaces and dashes, wide and mathematical letters.
constexpr Range foreign[] = {
    {0xa0, 0xa0},     {0x250, 0x36f},   {0x370, 0x58f},   {0x13a0, 0x13ff},   {0x1c80, 0x1c8f},
    {0x1f00, 0x1fff}, {0x2000, 0x200a}, {0x2010, 0x2015}, {0x202f, 0x202f},   {0x205f, 0x205f},
    {0x2160, 0x217f}, {0x2212, 0x2212}, {0x2c80, 0x2cff}, {0x2de0, 0x2dff},   {0x3000, 0x3000},
    {0xa640, 0xa69f}, {0xab70, 0xabbf}, {0xff00, 0xff5e}, {0x1d400, 0x1d7ff},
};

/// Characters that look like Latin letters: a word of nothing else looks like a Latin word.
constexpr Range look_alike[] = {
    {0x391, 0x392},   {0x395, 0x397},     {0x399, 0x39a}, {0x39c, 0x39d}, {0x39f, 0x39f},
    {0x3a1, 0x3a1},   {0x3a4, 0x3a5},     {0x3a7, 0x3a7}, {0x3b1, 0x3b1}, {0x3b9, 0x3ba},
    {0x3bd, 0x3bd},   {0x3bf, 0x3bf},     {0x3c1, 0x3c1}, {0x3c4, 0x3c5}, {0x3c7, 0x3c7},
    {0x3f2, 0x3f3},   {0x3f9, 0x3f9},     {0x405, 0x406}, {0x408, 0x408}, {0x410, 0x410},
    {0x412, 0x412},   {0x415, 0x415},     {0x41a, 0x41a}, {0x41c, 0x41e}, {0x420, 0x423},
    {0x425, 0x425},   {0x430, 0x430},     {0x435, 0x435}, {0x43e, 0x43e}, {0x440, 0x441},
    {0x443, 0x443},   {0x445, 0x445},     {0x455, 0x456}, {0x458, 0x458}, {0x4ae, 0x4af},
    {0x4ba, 0x4bb},   {0x4c0, 0x4c0},     {0x4cf, 0x4cf}, {0x501, 0x501}, {0x51a, 0x51d},
    {0xff21, 0xff5a}, {0x1d400, 0x1d7ff},
};

bool is_hidden(std::uint32_t code_point) { return is_in(hidden, code_point); }

bool is_in_word(char c) {
  const auto octet = static_cast<std::uint8_t>(c);
  return octet >= 0x80 || is_ascii_letter(c) || (c >= '0' && c <= '9');
}

/// True when the foreign characters of `word` make it look like another word.
bool deceives(std::string_view word) {
  bool has_look_alike = false;
  bool has_other = false;
  while (!word.empty()) {
    if (is_ascii_letter(word[0])) return true;
    const auto code_point = take_code_point(word);
    if (!code_point) return true;
    if (*code_point < 0x80 || is_hidden(*code_point)) continue;
    (is_in(look_alike, *code_point) ? has_look_alike : has_other) = true;
  }
  return has_look_alike && !has_other;
}

/// The word around the character at `at`.
std::string_view word_at(std::string_view text, std::size_t at) {
  std::size_t begin = at;
  while (begin > 0 && is_in_word(text[begin - 1])) --begin;
  while (at < text.size() && is_in_word(text[at])) ++at;
  return text.substr(begin, at - begin);
}

std::string escaped(std::uint32_t code_point) {
  if (code_point <= 0xffff) return fmt::format("\\u{:04x}", code_point);
  const std::uint32_t rest = code_point - 0x10000;
  return fmt::format("\\u{:04x}\\u{:04x}", 0xd800 | rest >> 10, 0xdc00 | (rest & 0x3ff));
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
  const std::string_view whole = text;
  const char* word_end = whole.data();
  bool is_deceptive = false;  // about the word up to `word_end`
  std::string out;
  out.reserve(text.size());
  while (out += take_plain(text), !text.empty()) {
    if (text.data() >= word_end) {
      const std::string_view word = word_at(whole, whole.size() - text.size());
      word_end = word.data() + word.size();
      is_deceptive = deceives(word);
    }
    std::string_view rest = text;
    const auto code_point = take_code_point(rest);
    if (!code_point || *code_point < 0x20) {
      out += fmt::format("\\x{:02x}", static_cast<std::uint8_t>(text[0]));
      text.remove_prefix(1);
      continue;
    }
    const bool is_escaped = is_control(*code_point) || is_hidden(*code_point) ||
                            (is_deceptive && is_in(foreign, *code_point));
    out += is_escaped ? escaped(*code_point) : std::string(text.data(), rest.data());
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
