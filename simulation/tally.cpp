// SPDX-License-Identifier: Apache-2.0
#include "simulation/tally.hpp"

#include <nlohmann/json.hpp>

namespace slamgw::sim {
namespace {

void add(nlohmann::ordered_json& to, const Tally& tally) {
  to["sent"] = tally.sent;
  to["acknowledged"] = tally.acknowledged;
  to["lost"] = tally.lost;
  to["commands_received"] = tally.commands_received;
}

}  // namespace

std::string to_json(const std::vector<std::pair<std::string, Tally>>& robots) {
  nlohmann::ordered_json document;
  document["robots"] = nlohmann::ordered_json::object();
  Tally total;
  for (const auto& [id, tally] : robots) {
    add(document["robots"][id], tally);
    total.sent += tally.sent;
    total.acknowledged += tally.acknowledged;
    total.lost += tally.lost;
    total.commands_received += tally.commands_received;
  }
  add(document, total);
  return document.dump();
}

}  // namespace slamgw::sim
