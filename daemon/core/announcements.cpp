// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/announcements.hpp"

#include <nlohmann/json.hpp>

namespace slamgw {

using Json = nlohmann::ordered_json;  // keys in the order of docs/topics.md

std::string presence_json(const Robot& robot) {
  const MeshPresence& presence = robot.presence();
  Json json{{"state", to_string(presence.presence)},
            {"mesh", to_string(robot.mesh())},
            {"address", presence.address},
            {"since", to_iso8601(presence.since)},
            {"last_seen", to_iso8601(robot.last_seen)}};
  if (!robot.radio) return json.dump();
  json["rssi_dbm"] = robot.radio->rssi_dbm;
  json["ttl"] = robot.radio->ttl;
  if (robot.radio->hops) json["hops"] = *robot.radio->hops;
  return json.dump();
}

std::string outcome_json(const CommandOutcome& outcome) {
  return Json{{"type", outcome.type},
              {"outcome", to_string(outcome.result)},
              {"after_ms", outcome.after.count()},
              {"why", outcome.why}}
      .dump();
}

}  // namespace slamgw
