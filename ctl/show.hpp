// SPDX-License-Identifier: Apache-2.0
// The daemon's answers as text for people: at most 80 columns, colour only where asked for. Pure;
// what is missing in an answer is left out, what could move the cursor is made harmless.
#pragma once

#include <chrono>
#include <cstdint>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>

namespace slamgw::ctl {

/// The member's text as it is, for comparing; "" when it is missing or no text.
std::string string_at(const nlohmann::json& object, const char* key);
/// The same for showing: what hides or deceives is escaped (escape_unprintable).
std::string text_at(const nlohmann::json& object, const char* key);
/// The member's number, or 0.
double number_at(const nlohmann::json& object, const char* key);
std::uint64_t count_at(const nlohmann::json& object, const char* key);
bool is_true(const nlohmann::json& object, const char* key);
/// The member, or an empty object or array.
const nlohmann::json& group_at(const nlohmann::json& object, const char* key);
const nlohmann::json& list_at(const nlohmann::json& object, const char* key);

/// Characters, taken as one column each.
std::size_t columns(std::string_view text);
/// Cut to `width` columns, `~` where something is missing: at the end, or at the start.
std::string cut_end(const std::string& text, std::size_t width);
std::string cut_start(const std::string& text, std::size_t width);
/// Breaks lines that are longer than `width` columns at spaces. What follows stands below the
/// line's second column of text, if it has columns.
std::string wrap(const std::string& text, std::size_t width);
std::string pad(const std::string& text, std::size_t width);
std::string pad_left(const std::string& text, std::size_t width);

std::string show_bytes(std::uint64_t bytes);      ///< "3.2 MiB"
std::string show_seconds(std::uint64_t seconds);  ///< "2 d 3 h", "12 s"
/// How long ago an ISO 8601 time in UTC was: "12s", "3m", "5h", "2d"; "" when it is no time.
std::string show_age(const std::string& time, std::chrono::system_clock::time_point now);

/// What texts depend on beside the answer.
struct Screen {
  bool with_colour = false;
  std::chrono::system_clock::time_point now;

  /// Green for what is well, red for what is not, yellow between.
  std::string paint(std::string_view state, std::string text) const;
};

/// Of a robot with `contested`.
inline constexpr std::string_view contested_words = "contested: another client uses its name";

/// Each text ends with a line end.
namespace show {

std::string status(const nlohmann::json& status, const Screen& screen);
std::string robots(const nlohmann::json& robots, const Screen& screen);
std::string event(const nlohmann::json& event, const Screen& screen);
std::string outcome(const nlohmann::json& outcome, const Screen& screen);

std::string fleet(const nlohmann::json& fleet, const Screen& screen);
/// A table of MQTT-SN sessions, or all of the one session that was asked for.
std::string clients(const nlohmann::json& clients, const Screen& screen);

/// A line for one ping, and one for all of them.
std::string ping(const nlohmann::json& ping, const Screen& screen);
std::string pings(std::uint64_t sent, std::uint64_t answered);
/// What a BLE node is configured with.
std::string config(const nlohmann::json& config, const Screen& screen);

/// Devices that no mesh has.
std::string devices(const nlohmann::json& devices);
/// BLE robots that are heard and are not among the nodes; a board may have them from before.
std::string foreign_robots(const nlohmann::json& robots, const nlohmann::json& nodes);
/// Robots of the BLE mesh.
std::string nodes(const nlohmann::json& nodes, const Screen& screen);
/// How far from the gateway each of them is: nearest first.
std::string topology(const nlohmann::json& topology, const Screen& screen);
/// Which robots hear which.
std::string hearing(const nlohmann::json& hearing);
/// The robot that was put out of the mesh.
std::string removed(const nlohmann::json& node);
/// How far the refresh of the mesh's keys has come.
std::string refresh(const nlohmann::json& refresh);
std::string exported_mesh(const nlohmann::json& exported);
/// How long new robots may join, and one event of a robot that joins.
std::string joining_head(const nlohmann::json& news);
/// For a terminal's last line.
std::string joining_countdown(const nlohmann::json& news);
std::string joining(const nlohmann::json& event, const Screen& screen);

/// Dead letters: the head of the table, and a page of it.
std::string dead_letters_head(const nlohmann::json& first_page);
std::string dead_letters(const nlohmann::json& letters, const Screen& screen);
std::string resent(const nlohmann::json& done);
std::string discarded(const nlohmann::json& done);

/// What an order has done: its members in words.
std::string done(const nlohmann::json& done);

}  // namespace show

}  // namespace slamgw::ctl
