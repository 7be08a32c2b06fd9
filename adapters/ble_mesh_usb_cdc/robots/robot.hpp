// SPDX-License-Identifier: Apache-2.0
// What BleMesh knows about one robot. Plain state; Robots, Uplink and Downlink hold the rules.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <set>
#include <string>

#include "adapters/ble_mesh_usb_cdc/access/robot_models.hpp"
#include "adapters/ble_mesh_usb_cdc/radio.hpp"
#include "adapters/ble_mesh_usb_cdc/robots/command_queue.hpp"
#include "adapters/ble_mesh_usb_cdc/robots/set_filter.hpp"

namespace slamgw::ble {

/// An acknowledged message that was left to another gateway, and comes again and again.
struct UnservedSet {
  MessageReceived message;  ///< its first copy
  TimePoint first{};
  TimePoint last{};
  bool is_repeated = false;

  /// Reliable publish doubles the time between copies: what comes much sooner is a new message.
  bool may_come_again(TimePoint now) const {
    return now - first <= SetFilter::longest_exchange && (now - last) * 5 >= (last - first) * 2;
  }
  /// The robot still waits for its STATUS: its next copy is not overdue.
  bool is_open(TimePoint now) const {
    constexpr Duration lateness = std::chrono::milliseconds{200};
    return is_repeated && now - last <= last - first + lateness;
  }
};

/// Acknowledged messages of one model.
struct Inbox {
  SetFilter filter;
  std::uint64_t open_receipt = 0;  ///< 0: none
  std::uint16_t element = 0;       ///< that the last message came from
  Bytes status;                    ///< the access message that acknowledges it
  std::optional<UnservedSet> unserved;
};

struct Robot {
  Robot(std::uint16_t its_address, std::string its_id, std::uint8_t ttl)
      : address(its_address), id(std::move(its_id)), commands(ttl) {}

  std::uint16_t address;  ///< unicast
  std::string id;
  bool is_node = false;     ///< in the database of nodes
  bool is_online = false;   ///< heard lately, whichever gateway serves it
  bool is_awaited = false;  ///< offline as soon as it is silent for long enough
  bool is_deaf = false;     ///< it does not hear the gateway
  /// What was reported last; nothing before the first report and after the robot was given up.
  std::optional<Presence> announced{};
  /// Since the radio came up: it sent an acknowledged message; it was seen to hear nothing.
  bool is_asking = false;
  bool is_deaf_now = false;
  TimePoint last_heard{};
  TimePoint sign_of_life_at{};           ///< of the last SignOfLife
  std::optional<std::uint8_t> sent_ttl;  ///< that it was configured to publish with
  std::uint8_t highest_ttl = 0;          ///< on arrival; the robot sends with at least this
  std::optional<std::uint16_t> key;      ///< of its last vendor message
  std::array<Inbox, vendor_model_count> inboxes;
  CommandQueue commands;
  TimePoint online_since{};
  /// Topics whose retained message it got since it came online; at most Downlink::max_retained.
  std::set<std::string, std::less<>> retained_given;
  bool is_subscribed = true;  ///< false: the broker refused it; asked again later

  /// How its message came. The number of relays is known when the TTL is that it was sent with.
  RadioFacts radio_facts(const MessageReceived& message) const {
    RadioFacts facts{message.rssi_dbm, std::nullopt, message.ttl};
    if (sent_ttl && message.ttl && *sent_ttl >= *message.ttl)
      facts.hops = static_cast<std::uint8_t>(*sent_ttl - *message.ttl);
    return facts;
  }
  bool is_expected() const { return is_online || is_awaited; }
  /// This gateway reports it as online.
  bool is_shown() const { return announced == Presence::online; }
  /// Announces it as offline unless it is heard: what the broker keeps may predate a restart.
  void await(TimePoint now) {
    if (announced) return;
    is_awaited = true;
    last_heard = now;
  }
};

}  // namespace slamgw::ble
