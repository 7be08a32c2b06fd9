// SPDX-License-Identifier: Apache-2.0
#include "simulation/tally.hpp"

#include <nlohmann/json.hpp>

namespace slamgw::sim {
namespace {

/// `total` decides which optional fields are present.
void add(nlohmann::ordered_json& to, const Tally& tally, const Tally& total) {
  to["sent"] = tally.sent;
  to["acknowledged"] = tally.acknowledged;
  to["lost"] = tally.lost;
  to["commands_received"] = tally.commands_received;
  if (total.roamed > 0) to["roamed"] = tally.roamed;
  if (total.wakes > 0) to["wakes"] = tally.wakes;
  if (total.will_updates > 0) to["will_updates"] = tally.will_updates;
  if (total.failed_assertions > 0) to["failed_assertions"] = tally.failed_assertions;
  if (!total.heard.empty()) to["heard"] = tally.heard;
}

}  // namespace

std::string to_json(const std::vector<std::pair<std::string, Tally>>& robots) {
  Tally total;
  for (const auto& [id, tally] : robots) {
    total.sent += tally.sent;
    total.acknowledged += tally.acknowledged;
    total.lost += tally.lost;
    total.commands_received += tally.commands_received;
    total.roamed += tally.roamed;
    total.wakes += tally.wakes;
    total.will_updates += tally.will_updates;
    total.failed_assertions += tally.failed_assertions;
    for (const auto& [sender, count] : tally.heard) total.heard[sender] += count;
  }
  nlohmann::ordered_json document;
  document["robots"] = nlohmann::ordered_json::object();
  for (const auto& [id, tally] : robots) add(document["robots"][id], tally, total);
  add(document, total, total);
  return document.dump();
}

}  // namespace slamgw::sim
