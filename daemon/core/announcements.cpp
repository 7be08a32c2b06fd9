// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/announcements.hpp"

#include <fmt/format.h>

#include <nlohmann/json.hpp>

namespace slamgw {

using Json = nlohmann::ordered_json;  // keys in the order of docs/topics.md

/// Written for each robot that comes, so without a tree of JSON values before.
std::string presence_json(const Robot& robot) {
  const MeshPresence& presence = robot.presence();
  std::string text = fmt::format(
      R"({{"state":"{}","mesh":"{}","address":{},"since":"{}","last_seen":"{}")",
      to_string(presence.presence), to_string(robot.mesh()), Json(presence.address).dump(),
      to_iso8601(presence.since), to_iso8601(robot.last_seen));
  if (const auto& radio = robot.radio) {
    text += fmt::format(R"(,"rssi_dbm":{},"ttl":{})", radio->rssi_dbm, radio->ttl);
    if (radio->hops) text += fmt::format(R"(,"hops":{})", *radio->hops);
  }
  return text + "}";
}

std::string outcome_json(const CommandOutcome& outcome) {
  return Json{{"type", outcome.type},
              {"outcome", to_string(outcome.result)},
              {"after_ms", outcome.after.count()},
              {"why", outcome.why}}
      .dump();
}

}  // namespace slamgw
