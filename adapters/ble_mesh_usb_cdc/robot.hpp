// SPDX-License-Identifier: Apache-2.0
// What BleMesh knows about one robot. Plain state; BleMesh holds the rules.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <set>
#include <string>

#include "adapters/ble_mesh_usb_cdc/access/vendor_models.hpp"
#include "adapters/ble_mesh_usb_cdc/command_queue.hpp"
#include "adapters/ble_mesh_usb_cdc/repeat_filter.hpp"

namespace slamgw::ble {

/// Acknowledged messages of one model.
struct Inbox {
  RepeatFilter filter;
  std::uint64_t open_receipt = 0;  ///< 0: none
};

struct Robot {
  Robot(std::uint16_t its_address, std::string its_id, std::uint8_t ttl)
      : address(its_address), id(std::move(its_id)), commands(ttl) {}

  std::uint16_t address;  ///< unicast
  std::string id;
  bool is_online = false;
  TimePoint last_heard{};
  std::uint8_t highest_ttl = 0;                ///< on arrival; the robot sends with at least this
  std::optional<std::uint16_t> appkey_handle;  ///< of its last vendor message
  std::array<Inbox, vendor_model_count> inboxes;
  CommandQueue commands;
  /// Topics whose retained message it got since it came online; at most BleMesh::max_retained.
  std::set<std::string, std::less<>> retained_given;
  bool is_subscribed = true;  ///< false: the broker said no, to be asked again
};

}  // namespace slamgw::ble
