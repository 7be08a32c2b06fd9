// SPDX-License-Identifier: Apache-2.0
// Pieces of text for show.hpp: safe, measured in columns, and in units that people read.
#pragma once

#include <chrono>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

namespace slamgw::ctl {

/// The member's text, or "" when it is missing or no text; control characters become `?`.
std::string text_at(const nlohmann::json& object, const char* key);
/// The member's number, or 0.
double number_at(const nlohmann::json& object, const char* key);
std::uint64_t count_at(const nlohmann::json& object, const char* key);
bool is_true(const nlohmann::json& object, const char* key);
/// The member, or an empty object.
const nlohmann::json& group_at(const nlohmann::json& object, const char* key);

/// Characters, taken as one column each.
std::size_t columns(std::string_view text);
/// Cut to `width` columns, `~` where something is missing: at the end, or at the start.
std::string cut_end(const std::string& text, std::size_t width);
std::string cut_start(const std::string& text, std::size_t width);
std::string pad(const std::string& text, std::size_t width);
std::string pad_left(const std::string& text, std::size_t width);

std::string show_bytes(std::uint64_t bytes);      ///< "3.2 MiB"
std::string show_seconds(std::uint64_t seconds);  ///< "2 d 3 h", "12 s"
/// How long ago an ISO 8601 time in UTC was: "12s", "3m", "5h", "2d"; "" when it is no time.
std::string show_age(const std::string& time, std::chrono::system_clock::time_point now);

}  // namespace slamgw::ctl
