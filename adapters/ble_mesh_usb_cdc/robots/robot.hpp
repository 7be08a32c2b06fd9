// SPDX-License-Identifier: Apache-2.0
// The state of one robot in BleMesh. Plain data; Robots, Uplink and Downlink hold the rules.
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

/// An acknowledged message that was left to another gateway and may come again and again.
struct UnservedSet {
  MessageReceived message;  ///< its first copy
  TimePoint first{};
  TimePoint last{};
  bool is_repeated = false;

  /// Returns true if a message now can be the next copy. Reliable publish doubles the time between
  /// copies, so a message that comes much sooner is new.
  bool may_come_again(TimePoint now) const {
    return now - first <= RepeatFilter::longest_exchange && (now - last) * 5 >= (last - first) * 2;
  }
  /// Returns true if the robot still waits for its STATUS: its next copy is not overdue.
  bool is_open(TimePoint now) const {
    constexpr Duration lateness = std::chrono::milliseconds{200};
    return is_repeated && now - last <= last - first + lateness;
  }
};

/// The acknowledged messages of one robot and one model.
struct Inbox {
  RepeatFilter filter;
  std::uint64_t open_receipt = 0;  ///< 0: none
  std::uint16_t element = 0;       ///< the source of the last message
  Bytes status;                    ///< the access message that acknowledges it
  std::optional<UnservedSet> unserved;
};

struct Robot {
  Robot(std::uint16_t its_address, std::string its_id, std::uint8_t ttl)
      : address(its_address), id(std::move(its_id)), commands(ttl) {}

  std::uint16_t address;  ///< unicast
  std::string id;
  bool is_node = false;                  ///< in the database of nodes
  bool is_online = false;                ///< heard lately, whichever gateway serves it
  bool is_presence_unconfirmed = false;  ///< goes offline when silent for long enough
  bool is_deaf = false;                  ///< it does not hear the gateway
  /// The presence that was reported last; empty before the first report and after the robot was
  /// given up.
  std::optional<Presence> announced{};
  /// Since the radio came up, the robot has sent an acknowledged message (`is_asking`), and was
  /// seen not to hear the gateway (`is_deaf_now`).
  bool is_asking = false;
  bool is_deaf_now = false;
  TimePoint last_heard{};
  TimePoint sign_of_life_at{};           ///< of the last SignOfLife
  std::optional<std::uint8_t> sent_ttl;  ///< configured by the gateway, for publishing
  std::uint8_t highest_ttl = 0;          ///< on arrival; the robot sends with at least this
  std::optional<std::uint16_t> key;      ///< of its last vendor message
  std::array<Inbox, vendor_model_count> inboxes;
  CommandQueue commands;
  TimePoint online_since{};
  /// Topics whose retained message the robot got since it came online; at most
  /// Downlink::max_retained.
  std::set<std::string, std::less<>> retained_given;
  bool misses_retained = false;  ///< a retained message came while the link was down
  bool is_subscribed = true;     ///< false: the broker refused; asked again later

  /// Returns how the robot's message came. The number of relays is known only if the TTL that the
  /// robot sent with is known.
  RadioFacts radio_facts(const MessageReceived& message) const {
    RadioFacts facts{message.rssi_dbm, std::nullopt, message.ttl};
    if (sent_ttl && message.ttl && *sent_ttl >= *message.ttl)
      facts.hops = static_cast<std::uint8_t>(*sent_ttl - *message.ttl);
    return facts;
  }
  bool is_expected() const { return is_online || is_presence_unconfirmed; }
  /// Returns true if this gateway reports the robot as online.
  bool is_shown() const { return announced == Presence::online; }
  /// Announces the robot as offline unless it is heard soon: its presence at the broker may predate
  /// a restart.
  void await(TimePoint now) {
    if (announced) return;
    is_presence_unconfirmed = true;
    last_heard = now;
  }
};

// The state that Robots, Uplink and Downlink share, and the decision whether this gateway handles a
// robot's messages. It always does so in a mesh that only its own radio hears. In a shared mesh,
// all radios hear a robot. Only the gateway that holds the robot's session at the broker reports
// and acknowledges its messages.

class ServiceGate {
 public:
  /// Returns true if this gateway holds the robot's session.
  using MayServe = std::function<bool(const std::string& robot)>;

  /// `nodes` must outlive this object. `has_group`: robots publish to a group of the gateways.
  /// Without a group, a single radio hears them, even if other gateways have the keys.
  ServiceGate(const NodeTable& nodes, bool has_group) : nodes_(nodes), has_group_(has_group) {}

  void ask(MayServe may_serve) { may_serve_ = std::move(may_serve); }
  /// Returns true if other gateways' radios hear the robots of this mesh, too.
  bool is_shared() const { return has_group_ && nodes_.is_shared(); }
  bool is_open_for(const Robot& robot) const { return !is_shared() || may_serve_(robot.id); }
  /// Returns true for a robot that joined after this gateway imported the mesh. Only the gateway
  /// that took the robot in knows its name; this one would publish under another.
  bool is_stranger(std::uint16_t address) const {
    return nodes_.is_guest() && nodes_.find_joined(address) == nullptr;
  }

 private:
  const NodeTable& nodes_;
  const bool has_group_;
  MayServe may_serve_ = [](const std::string&) { return true; };
};

/// The references that the parts of BleMesh share. All of them must outlive the part.
struct MeshPart {
  void emit(MeshEvent event) { actions_.push(std::move(event)); }
  void warn(std::string text, std::string robot = {}) {
    emit(Notice{Severity::warning, std::move(text), std::move(robot)});
  }

  const Settings& settings_;
  const TopicScheme& topics_;
  Radio& radio_;
  const LinkState& link_;
  const ServiceGate& gate_;
  MeshActions& actions_;
  const bool& is_traced_;  ///< each transmission and acknowledgement is a MessageStep
};

}  // namespace slamgw::ble
