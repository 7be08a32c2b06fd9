// SPDX-License-Identifier: Apache-2.0
#include "ctl/text.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <ctime>

#include "daemon/control/wire.hpp"

namespace slamgw::ctl {
namespace {

bool is_continuation(char c) { return (static_cast<unsigned char>(c) & 0xc0) == 0x80; }

/// The first octet of the character in this column.
std::size_t offset_of(std::string_view text, std::size_t column) {
  std::size_t at = 0;
  for (; at < text.size(); ++at)
    if (!is_continuation(text[at]) && column-- == 0) break;
  return at;
}

}  // namespace

std::string text_at(const nlohmann::json& object, const char* key) {
  const auto found = object.find(key);
  if (found == object.end() || !found->is_string()) return "";
  std::string text = found->get<std::string>();
  if (control::is_printable(text)) return text;
  for (char& c : text)
    if (!control::is_printable(std::string_view(&c, 1))) c = '?';
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

const nlohmann::json& group_at(const nlohmann::json& object, const char* key) {
  static const nlohmann::json empty = nlohmann::json::object();
  const auto found = object.find(key);
  return found == object.end() || !found->is_object() ? empty : *found;
}

std::size_t columns(std::string_view text) {
  std::size_t count = 0;
  for (const char c : text) count += is_continuation(c) ? 0 : 1;
  return count;
}

std::string cut_end(const std::string& text, std::size_t width) {
  if (columns(text) <= width) return text;
  return text.substr(0, offset_of(text, width - 1)) + "~";
}

std::string cut_start(const std::string& text, std::size_t width) {
  if (columns(text) <= width) return text;
  return "~" + text.substr(offset_of(text, columns(text) - (width - 1)));
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
