// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/announcements.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>

// Formatted directly, without a tree of JSON values: this runs for each robot that comes and each
// command that ends. Keys are in the order of docs/topics.md.
namespace slamgw {

std::string json_string(std::string_view text) {
  const bool is_plain = std::ranges::all_of(
      text, [](char c) { return c >= ' ' && c <= '~' && c != '"' && c != '\\'; });
  return is_plain
             ? fmt::format("\"{}\"", text)
             : nlohmann::json(text).dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

std::string presence_json(const Robot& robot) {
  const MeshPresence& presence = robot.presence();
  std::string text = fmt::format(
      R"({{"state":"{}","mesh":"{}","address":{},"since":"{}","last_seen":"{}")",
      to_string(presence.presence), to_string(robot.mesh()), json_string(presence.address),
      to_iso8601(presence.since), to_iso8601(robot.last_seen));
  if (presence.is_deaf) text += R"(,"deaf":true)";
  if (robot.is_contested()) text += R"(,"contested":true)";
  const RadioFacts radio = robot.radio_now();
  if (radio.rssi_dbm) text += fmt::format(R"(,"rssi_dbm":{})", *radio.rssi_dbm);
  if (radio.ttl) text += fmt::format(R"(,"ttl":{})", *radio.ttl);
  if (radio.hops) text += fmt::format(R"(,"hops":{})", *radio.hops);
  return text + "}";
}

std::string outcome_json(const CommandOutcome& outcome) {
  return fmt::format(R"({{"type":{},"outcome":"{}","after_ms":{},"why":{}}})",
                     json_string(outcome.type), to_string(outcome.result), outcome.after.count(),
                     json_string(outcome.why));
}

}  // namespace slamgw
