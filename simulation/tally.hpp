// SPDX-License-Identifier: Apache-2.0
// The counters of one robot, and the JSON object that the program prints at its end.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

namespace slamgw::sim {

/// `update` messages only; a robot's first `adv` is not counted.
struct Tally {
  std::uint64_t sent = 0;          ///< given to the mesh at least once
  std::uint64_t acknowledged = 0;  ///< PUBACK, PUBCOMP or STATUS seen; 0 without acknowledgements
  std::uint64_t lost =
      0;  ///< given up, refused by a full queue, or, unacknowledged, dropped by --loss
  std::uint64_t commands_received = 0;
  std::uint64_t roamed = 0;             ///< moves to a new address
  std::uint64_t wakes = 0;              ///< PINGREQs of a sleeping robot, without repeats
  std::uint64_t will_updates = 0;       ///< topic and message both accepted
  std::uint64_t failed_assertions = 0;  ///< stops the robot

  std::map<std::string, std::uint64_t> heard{};  ///< updates of others, by id or, on BLE, number

  bool operator==(const Tally&) const = default;
};

/// One line:
/// `{"robots":{"<id>":{...}},"sent":..,"acknowledged":..,"lost":..,"commands_received":..}`
/// `roamed`, `wakes`, `will_updates`, `failed_assertions` and `heard` are present only when a robot
/// has any; `heard` is an object of counts by sender.
std::string to_json(const std::vector<std::pair<std::string, Tally>>& robots);

}  // namespace slamgw::sim
