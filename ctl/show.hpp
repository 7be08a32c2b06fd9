// SPDX-License-Identifier: Apache-2.0
// The daemon's answers as text for people: at most 80 columns, colour only where asked for. Pure;
// what is missing in an answer is left out, what could move the cursor is made harmless. show.cpp:
// links, robots and messages; show_fleet.cpp, show_mesh.cpp, show_store.cpp: the rest.
#pragma once

#include <chrono>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

namespace slamgw::ctl {

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

/// Devices that no mesh has.
std::string devices(const nlohmann::json& devices);
/// Robots of the BLE mesh.
std::string nodes(const nlohmann::json& nodes, const Screen& screen);
/// The robot that was put out of the mesh.
std::string removed(const nlohmann::json& node);
std::string exported_mesh(const nlohmann::json& exported);
/// How long new robots may join, and one event of a robot that joins.
std::string joining_head(const nlohmann::json& news);
std::string joining(const nlohmann::json& event, const Screen& screen);

/// Messages that were set aside: the head of the table, and a page of it.
std::string dead_letters_head(const nlohmann::json& first_page);
std::string dead_letters(const nlohmann::json& letters, const Screen& screen);
std::string resent(const nlohmann::json& done);
std::string discarded(const nlohmann::json& done);

/// What an order has done: its members in words.
std::string done(const nlohmann::json& done);

}  // namespace show
}  // namespace slamgw::ctl
