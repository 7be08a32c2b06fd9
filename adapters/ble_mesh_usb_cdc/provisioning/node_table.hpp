// SPDX-License-Identifier: Apache-2.0
// The nodes of the mesh: their database and whether the disk has it, what they are called, and what
// was seen of them since the daemon started. Nothing is used on the air before it is on disk: an
// address before a device gets it, a device key before it is spoken with. BleMeshShell writes.
// Part of Provisioner.
#pragma once

#include <map>
#include <optional>
#include <set>
#include <string>
#include <utility>

#include "adapters/ble_mesh_usb_cdc/provisioning/node_database.hpp"
#include "adapters/ble_mesh_usb_cdc/settings.hpp"
#include "daemon/core/robot_names.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::ble {

/// One node, since the daemon started.
struct NodeHistory {
  std::optional<TimePoint> heard_at = {};
  std::optional<TimePoint> joined_at = {};
  TimePoint retry_at = TimePoint::min();  ///< of its configuration
  int failures = 0;                       ///< of its configuration, in a row
  bool has_restarted_radio = false;       ///< because it was not heard after it had joined
  std::string problem = {};               ///< why it is not configured; empty when it is

  void forget_failures() {
    failures = 0;
    problem.clear();
  }
};

class NodeTable {
 public:
  /// Of a write that failed.
  static constexpr Duration store_retry_interval = std::chrono::seconds{5};

  NodeTable(const Settings& settings, RobotNames names, std::optional<NodeDatabase> database)
      : settings_(settings), names_(std::move(names)), database_(std::move(database)) {}

  /// Nothing while the gateway has no keys of the mesh.
  const NodeDatabase* database() const { return database_ ? &*database_ : nullptr; }
  /// To change it; there must be one.
  NodeDatabase& change() {
    is_changed_ = true;
    return *database_;
  }
  /// A mesh begins, which the disk has already; or the disk did not take another in its place.
  void begin(std::optional<NodeDatabase> database);
  /// Another mesh takes the place of this one.
  void replace(NodeDatabase database);

  bool is_saved() const { return !is_changed_ && !is_writing_; }
  /// What to write now, if anything; answered by on_stored.
  const NodeDatabase* take_write(TimePoint now);
  void on_stored(bool is_done, TimePoint now);
  std::optional<TimePoint> deadline() const { return is_writing_ ? std::nullopt : store_retry_at_; }

  /// Another gateway takes robots in and configures them.
  bool is_guest() const { return database() != nullptr && database()->guest_address; }
  /// Other gateways have radios in this mesh.
  bool is_shared() const { return is_guest() || (database() && !database()->gateways.empty()); }
  const Node* find(const Uuid& uuid) const { return database() ? database()->find(uuid) : nullptr; }
  /// The node that has this address on any of its elements; null when there is none.
  const Node* find(std::uint16_t address) const {
    return database() ? database()->find_address(address) : nullptr;
  }
  /// The same, but null for a node that has not joined yet.
  const Node* find_joined(std::uint16_t address) const;

  /// A node, or its name, is different from before.
  void announce_change() { is_change_announced_ = true; }
  /// Once after each such change.
  bool take_change() { return std::exchange(is_change_announced_, false); }
  /// It is no node any more, and is taken in again only by hand.
  void remove(Uuid uuid);

  void on_names(RobotNames names) { names_ = std::move(names); }
  const RobotNames& names() const { return names_; }
  /// What the robot with this unicast address is called.
  std::string id_of(std::uint16_t address) const;
  /// True when a joined node at another address goes by this name.
  bool is_elsewhere(const std::string& id, std::uint16_t address) const;
  /// What the configuration calls it; null when it does not name it.
  const std::string* configured_name(std::uint16_t address) const;

  /// A message came from this unicast address.
  void on_heard(std::uint16_t address, TimePoint now);
  NodeHistory& history(const Uuid& uuid) { return histories_[uuid]; }
  /// Null when nothing happened to it yet.
  const NodeHistory* find_history(const Uuid& uuid) const;

  /// Unicast addresses of others than nodes: those of gateways, used or not yet, and of robots that
  /// another tool has taken in.
  std::set<std::uint16_t> taken_addresses() const;
  /// How many addresses the gateway at this one has for the lives of its radio, at least one.
  std::uint16_t room_at(std::uint16_t gateway) const;
  /// The same of this gateway.
  std::uint16_t source_room() const;
  /// For a new robot, or one that was reset by hand. `name`: given by an operator; may be empty.
  std::optional<std::uint16_t> address_for(const Uuid& uuid, std::uint8_t elements,
                                           const std::string& name) const;
  /// For another gateway (`ble export`): where most addresses follow.
  std::optional<std::uint16_t> address_for_gateway() const;

  /// `slam-gatewayctl ble nodes`.
  std::string json() const;
  std::string json(const Node& node) const;

 private:
  const Settings& settings_;
  RobotNames names_;
  std::optional<NodeDatabase> database_;
  bool is_changed_ = false;
  bool is_writing_ = false;
  std::optional<TimePoint> store_retry_at_;
  bool is_change_announced_ = false;
  std::map<Uuid, NodeHistory> histories_;
  /// Heard, but no node: robots that another tool has taken in. At most NodeDatabase::max_nodes.
  std::set<std::uint16_t> strangers_;
};

}  // namespace slamgw::ble
