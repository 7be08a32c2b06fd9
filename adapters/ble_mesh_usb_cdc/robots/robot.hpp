// SPDX-License-Identifier: Apache-2.0
// What BleMesh knows about one robot. Plain state; Robots, Uplink and Downlink hold the rules.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <optional>
#include <set>
#include <string>
#include <utility>

#include "adapters/ble_mesh_usb_cdc/access/robot_models.hpp"
#include "adapters/ble_mesh_usb_cdc/mesh_action.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/node_table.hpp"
#include "adapters/ble_mesh_usb_cdc/radio.hpp"
#include "adapters/ble_mesh_usb_cdc/robots/command_queue.hpp"
#include "adapters/ble_mesh_usb_cdc/robots/repeat_filter.hpp"
#include "daemon/core/topic_scheme.hpp"

namespace slamgw::ble {

/// An acknowledged message that was left to another gateway, and comes again and again.
struct UnservedSet {
  MessageReceived message;  ///< its first copy
  TimePoint first{};
  TimePoint last{};
  bool is_repeated = false;

  /// Reliable publish doubles the time between copies: what comes much sooner is a new message.
  bool may_come_again(TimePoint now) const {
    return now - first <= RepeatFilter::longest_exchange && (now - last) * 5 >= (last - first) * 2;
  }
  /// The robot still waits for its STATUS: its next copy is not overdue.
  bool is_open(TimePoint now) const {
    constexpr Duration lateness = std::chrono::milliseconds{200};
    return is_repeated && now - last <= last - first + lateness;
  }
};

/// Acknowledged messages of one model.
struct Inbox {
  RepeatFilter filter;
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

// What Robots, Uplink and Downlink share; and whether this gateway deals with what a robot says. In
// a mesh that only this gateway's radio hears, always. In one that several gateways share, all
// radios hear a robot. The gateway that holds the robot's session at the broker reports and
// acknowledges what it says; the others are silent.

class ServiceGate {
 public:
  /// Whether this gateway holds the robot's session.
  using MayServe = std::function<bool(const std::string& robot)>;

  /// `nodes` outlives it. `has_group`: robots publish to a group of the gateways. Without one, a
  /// single radio hears them, even if other gateways have the keys.
  ServiceGate(const NodeTable& nodes, bool has_group) : nodes_(nodes), has_group_(has_group) {}

  void ask(MayServe may_serve) { may_serve_ = std::move(may_serve); }
  /// Other gateways have radios in this mesh.
  bool is_shared() const { return has_group_ && nodes_.is_shared(); }
  bool is_open_for(const Robot& robot) const { return !is_shared() || may_serve_(robot.id); }
  /// A robot that joined after the mesh was brought in here: the gateway that took it in knows its
  /// name, this one does not, and would publish under another.
  bool is_stranger(std::uint16_t address) const {
    return nodes_.is_guest() && nodes_.find_joined(address) == nullptr;
  }

 private:
  const NodeTable& nodes_;
  const bool has_group_;
  MayServe may_serve_ = [](const std::string&) { return true; };
};

/// All of them outlive it.
struct MeshPart {
  void emit(MeshEvent event) { actions_.push(std::move(event)); }

  const Settings& settings_;
  const TopicScheme& topics_;
  Radio& radio_;
  const LinkState& link_;
  const ServiceGate& gate_;
  MeshActions& actions_;
  const bool& is_traced_;  ///< each transmission and acknowledgement is a MeshStep
};

}  // namespace slamgw::ble
