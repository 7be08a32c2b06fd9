// SPDX-License-Identifier: Apache-2.0
#include "ctl/text.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <ctime>

#include "daemon/core/utf8.hpp"

namespace slamgw::ctl {
namespace {

/// One character and where the next one begins. `text` is UTF-8 (text_at sees to it); what is not
/// counts octet by octet.
struct Character {
  char32_t code = 0;
  std::size_t end = 0;
};

Character character_at(std::string_view text, std::size_t at) {
  const auto first = static_cast<unsigned char>(text[at]);
  const std::size_t size = first >= 0xf0 ? 4 : first >= 0xe0 ? 3 : first >= 0xc0 ? 2 : 1;
  Character character{size == 1 ? first : first & (0xffU >> (size + 1)), at + 1};
  while (character.end < std::min(at + size, text.size()))
    character.code =
        character.code << 6 | (static_cast<unsigned char>(text[character.end++]) & 0x3fU);
  return character;
}

struct Range {
  char32_t first;
  char32_t last;
};

/// What terminals draw over the character before it, and what they draw two columns wide: the large
/// blocks, good enough for a robot's name.
constexpr Range zero_wide[] = {{0x300, 0x36f}, {0x200b, 0x200f}, {0xfe00, 0xfe0f}};
constexpr Range double_wide[] = {{0x1100, 0x115f}, {0x2e80, 0xa4cf},   {0xac00, 0xd7a3},
                                 {0xf900, 0xfaff}, {0xfe30, 0xfe6f},   {0xff00, 0xff60},
                                 {0xffe0, 0xffe6}, {0x1f300, 0x1faff}, {0x20000, 0x3fffd}};

std::size_t width_of(char32_t code) {
  const auto has_code = [code](const Range& range) {
    return code >= range.first && code <= range.last;
  };
  if (std::ranges::any_of(zero_wide, has_code)) return 0;
  return std::ranges::any_of(double_wide, has_code) ? 2 : 1;
}

}  // namespace

std::string text_at(const nlohmann::json& object, const char* key) {
  const auto found = object.find(key);
  if (found == object.end() || !found->is_string()) return "";
  std::string text = found->get<std::string>();
  if (is_printable(text)) return text;
  for (char& c : text)
    if (!is_printable(std::string_view(&c, 1))) c = '?';
  return text;
}

double number_at(const nlohmann::json& object, const char* key) {
  const auto found = object.find(key);
  return found == object.end() || !found->is_number() ? 0.0 : found->get<double>();
}

std::uint64_t count_at(const nlohmann::json& object, const char* key) {
  const auto found = object.find(key);
  const bool is_count = found != object.end() && found->is_number_integer() && *found >= 0;
  return is_count ? found->get<std::uint64_t>() : 0;
}

bool is_true(const nlohmann::json& object, const char* key) {
  const auto found = object.find(key);
  return found != object.end() && *found == true;
}

const nlohmann::json& group_at(const nlohmann::json& object, const char* key) {
  static const nlohmann::json empty = nlohmann::json::object();
  const auto found = object.find(key);
  return found == object.end() || !found->is_object() ? empty : *found;
}

std::size_t columns(std::string_view text) {
  std::size_t count = 0;
  for (std::size_t at = 0; at < text.size();) {
    const Character character = character_at(text, at);
    count += width_of(character.code);
    at = character.end;
  }
  return count;
}

std::string cut_end(const std::string& text, std::size_t width) {
  if (columns(text) <= width) return text;
  std::size_t end = 0;
  for (std::size_t used = 0; end < text.size();) {
    const Character character = character_at(text, end);
    if (used += width_of(character.code); used > width - 1) break;
    end = character.end;
  }
  return text.substr(0, end) + "~";
}

std::string cut_start(const std::string& text, std::size_t width) {
  std::size_t left = columns(text);
  if (left <= width) return text;
  std::size_t begin = 0;
  while (left > width - 1) {
    const Character character = character_at(text, begin);
    left -= width_of(character.code);
    begin = character.end;
  }
  return "~" + text.substr(begin);
}

std::string pad(const std::string& text, std::size_t width) {
  return text + std::string(width - std::min(width, columns(text)), ' ');
}

std::string pad_left(const std::string& text, std::size_t width) {
  return std::string(width - std::min(width, columns(text)), ' ') + text;
}

std::string show_bytes(std::uint64_t bytes) {
  constexpr std::uint64_t unit = 1024;
  if (bytes < unit) return fmt::format("{} B", bytes);
  if (bytes < unit * unit) return fmt::format("{:.1f} KiB", static_cast<double>(bytes) / unit);
  return fmt::format("{:.1f} MiB", static_cast<double>(bytes) / (unit * unit));
}

std::string show_seconds(std::uint64_t seconds) {
  const std::uint64_t minutes = seconds / 60;
  const std::uint64_t hours = minutes / 60;
  if (minutes == 0) return fmt::format("{} s", seconds);
  if (hours == 0) return fmt::format("{} min {} s", minutes, seconds % 60);
  if (hours < 24) return fmt::format("{} h {} min", hours, minutes % 60);
  return fmt::format("{} d {} h", hours / 24, hours % 24);
}

std::string show_age(const std::string& time, std::chrono::system_clock::time_point now) {
  std::tm fields{};
  if (strptime(time.c_str(), "%Y-%m-%dT%H:%M:%S", &fields) == nullptr) return "";
  const auto then = std::chrono::system_clock::from_time_t(timegm(&fields));
  const auto age = std::chrono::duration_cast<std::chrono::seconds>(now - then).count();
  if (age < 60) return fmt::format("{}s", std::max<std::int64_t>(age, 0));
  if (age < 3600) return fmt::format("{}m", age / 60);
  if (age < 86400) return fmt::format("{}h", age / 3600);
  return fmt::format("{}d", age / 86400);
}

}  // namespace slamgw::ctl
