// SPDX-License-Identifier: Apache-2.0
// The daemon's answers as text for people: at most 80 columns, colour only on request. Pure. Leaves
// out missing members of an answer, and escapes characters that could move the cursor.
#pragma once

#include <chrono>
#include <cstdint>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>

namespace slamgw::ctl {

/// The member's text as it is, for comparing; "" when it is missing or not a text.
std::string string_at(const nlohmann::json& object, const char* key);
/// The member's text for showing: characters that hide or deceive are escaped (escape_unprintable).
std::string text_at(const nlohmann::json& object, const char* key);
/// The text as one word for a shell: quoted, unless it is plain. For names that robots have chosen.
std::string shell_word(const std::string& text);
/// The member's number, or 0.
double number_at(const nlohmann::json& object, const char* key);
std::uint64_t count_at(const nlohmann::json& object, const char* key);
bool is_true(const nlohmann::json& object, const char* key);
/// The member, or an empty object or array.
const nlohmann::json& group_at(const nlohmann::json& object, const char* key);
const nlohmann::json& list_at(const nlohmann::json& object, const char* key);

/// The number of columns that the text takes on a terminal.
std::size_t columns(std::string_view text);
/// Cuts the text to `width` columns, at its end or at its start; `~` marks the cut.
std::string cut_end(const std::string& text, std::size_t width);
std::string cut_start(const std::string& text, std::size_t width);
/// Breaks lines that are longer than `width` columns at spaces. The next lines are indented to the
/// second column of text, if the line has columns.
std::string wrap(const std::string& text, std::size_t width);
std::string pad(const std::string& text, std::size_t width);
std::string pad_left(const std::string& text, std::size_t width);

std::string show_bytes(std::uint64_t bytes);      ///< "3.2 MiB"
std::string show_seconds(std::uint64_t seconds);  ///< "2 d 3 h", "12 s"
/// The age of an ISO 8601 time in UTC: "12s", "3m", "5h", "2d"; "" for any other text.
std::string show_age(const std::string& time, std::chrono::system_clock::time_point now);

/// The surroundings on which texts depend beside the answer.
struct Screen {
  bool with_colour = false;
  std::chrono::system_clock::time_point now;

  /// Paints good states green, bad states red, and states between them yellow.
  std::string paint(std::string_view state, std::string text) const;
};

/// Returns the count and the words that agree with it: "1 message", "3 messages".
std::string counted(std::uint64_t count, std::string_view one, std::string_view many);

/// Shown for a robot with `contested`.
inline constexpr std::string_view contested_words = "contested: another client uses its name";

/// Each text ends with a line end.
namespace show {

std::string status(const nlohmann::json& status, const Screen& screen);
std::string robots(const nlohmann::json& robots, const Screen& screen);
std::string event(const nlohmann::json& event, const Screen& screen);
std::string outcome(const nlohmann::json& outcome, const Screen& screen);

std::string fleet(const nlohmann::json& fleet, const Screen& screen);
/// A table of MQTT-SN sessions, or all facts of one session if the answer has only that.
std::string clients(const nlohmann::json& clients, const Screen& screen);

/// A line for one ping, and a line for all pings.
std::string ping(const nlohmann::json& ping, const Screen& screen);
std::string pings(std::uint64_t sent, std::uint64_t answered);
/// The configuration of a BLE node.
std::string config(const nlohmann::json& config, const Screen& screen);

/// Devices that belong to no mesh.
std::string devices(const nlohmann::json& devices, const Screen& screen);
/// BLE robots that are heard but are not among the nodes; a board may know them from before.
std::string foreign_robots(const nlohmann::json& robots, const nlohmann::json& nodes);
/// Robots of the BLE mesh.
std::string nodes(const nlohmann::json& nodes, const Screen& screen);
/// The distance of each robot from the gateway, nearest first.
std::string topology(const nlohmann::json& topology, const Screen& screen);
/// For each robot, the robots that hear it.
std::string hearing(const nlohmann::json& hearing, const Screen& screen);
/// The robot that was removed from the mesh.
std::string removed(const nlohmann::json& node, const Screen& screen);
/// The progress of the refresh of the mesh's keys.
std::string refresh(const nlohmann::json& refresh, const Screen& screen);
std::string exported_mesh(const nlohmann::json& exported, const Screen& screen);
/// The time for which new robots may join.
std::string joining_head(const nlohmann::json& news);
/// The time that is left, for a terminal's last line.
std::string joining_countdown(const nlohmann::json& news);
/// One event of a robot that joins.
std::string joining(const nlohmann::json& event, const Screen& screen);

/// Dead letters: the head of the table, and a page of it.
std::string dead_letters_head(const nlohmann::json& first_page, bool is_of_topic);
std::string dead_letters(const nlohmann::json& letters, const Screen& screen);
std::string resent(const nlohmann::json& done, const Screen& screen);
std::string discarded(const nlohmann::json& done, const Screen& screen);

/// The result of an order in words.
std::string done(const nlohmann::json& done, const Screen& screen);

}  // namespace show

}  // namespace slamgw::ctl
