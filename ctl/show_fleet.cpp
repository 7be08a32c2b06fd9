// SPDX-License-Identifier: Apache-2.0
// What slam-gatewayctl shows of the gateways on one broker.
#include <fmt/format.h>

#include <algorithm>

#include "ctl/show.hpp"
#include "ctl/text.hpp"

namespace slamgw::ctl::show {

using nlohmann::json;

namespace {

/// The member, or an empty array.
json list_at(const json& object, const char* key) {
  const auto found = object.find(key);
  return found == object.end() || !found->is_array() ? json::array() : *found;
}

std::size_t widest(const json& rows, const char* key, std::size_t head) {
  constexpr std::size_t most = 24;
  std::size_t width = head;
  for (const json& row : rows) width = std::max(width, columns(text_at(row, key)));
  return std::min(width, most);
}

}  // namespace

std::string fleet(const json& fleet, const Screen& screen) {
  const json gateways = list_at(fleet, "gateways");
  const json robots = list_at(fleet, "robots");
  const std::size_t width = std::max(widest(gateways, "gateway", 7), widest(robots, "gateway", 7));
  std::string out = pad("GATEWAY", width) + " STATE   ROBOTS UP   VERSION\n";
  for (const json& gateway : gateways) {
    const std::string state = text_at(gateway, "state");
    const std::string age = show_age(text_at(gateway, "since"), screen.now);
    std::string line =
        fmt::format("{} {} {:>6} {} {}", pad(cut_end(text_at(gateway, "gateway"), width), width),
                    screen.paint(state, pad(state, 7)), count_at(gateway, "robots"), pad(age, 4),
                    text_at(gateway, "version"));
    line.erase(line.find_last_not_of(' ') + 1);
    out += line + "\n";
  }
  if (robots.empty()) return out;
  const std::size_t id = widest(robots, "robot", 5);
  out += fmt::format("\n{} {} SINCE\n", pad("ROBOT", id), pad("GATEWAY", width));
  for (const json& robot : robots) {
    const auto served = robot.find("served");
    std::string trouble;
    const bool is_here = text_at(robot, "gateway") == text_at(fleet, "gateway");
    if (served != robot.end() && *served == false)
      trouble = fmt::format(" ({})",
                            screen.paint("down", is_here ? "its session at the broker is not held"
                                                         : "that gateway is silent"));
    if (is_true(robot, "contested"))
      trouble += fmt::format(" ({})", screen.paint("contested", std::string(contested_words)));
    out += fmt::format("{} {} {}{}\n", pad(cut_end(text_at(robot, "robot"), id), id),
                       pad(cut_end(text_at(robot, "gateway"), width), width),
                       show_age(text_at(robot, "since"), screen.now), trouble);
  }
  return out;
}

}  // namespace slamgw::ctl::show
