// SPDX-License-Identifier: Apache-2.0
// The nodes of the mesh: their database and whether it is on disk, their names, and their history
// since the daemon started. No address and no device key is used on the air before it is on disk.
// BleMeshShell writes the database. Part of Provisioner.
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

/// The history of one node since the daemon started.
struct NodeHistory {
  std::optional<TimePoint> heard_at = {};
  std::optional<TimePoint> joined_at = {};
  TimePoint retry_at = TimePoint::min();  ///< of its configuration
  int failures = 0;                       ///< of its configuration, in a row
  bool has_restarted_radio = false;       ///< because it was not heard after joining
  std::uint16_t left_address = 0;         ///< where it was before it joined again; 0: none
  std::string problem = {};               ///< why it is not configured; else empty

  void forget_failures() {
    failures = 0;
    problem.clear();
  }
};

class NodeTable {
 public:
  /// Pause before a failed write is repeated.
  static constexpr Duration store_retry_interval = std::chrono::seconds{5};
  /// Messages from a stranger's address before it limits the gateway's own addresses: a forged or
  /// damaged message can name any address.
  static constexpr int believed_after = 3;

  NodeTable(const Settings& settings, RobotNames names, std::optional<NodeDatabase> database)
      : settings_(settings), names_(std::move(names)), database_(std::move(database)) {}

  /// Returns null while the gateway has no keys of the mesh on disk.
  const NodeDatabase* database() const {
    return database_ && !is_beginning_ ? &*database_ : nullptr;
  }
  /// Returns the database, which must exist, for a change. take_write() hands the change out.
  NodeDatabase& change() {
    is_changed_ = true;
    return *database_;
  }
  /// Begins a new mesh. It counts when it is on disk; if the disk does not take it, there is none.
  void begin(const MeshKeys& keys);
  bool is_beginning() const { return is_beginning_; }
  /// Replaces the mesh by another one, which must then be written, or by none.
  void replace(std::optional<NodeDatabase> database);

  bool is_saved() const { return !is_changed_ && !is_writing_; }
  /// Returns the database to write now, or null; answered by on_stored.
  const NodeDatabase* take_write(TimePoint now);
  void on_stored(bool is_done, TimePoint now);
  std::optional<TimePoint> deadline() const { return is_writing_ ? std::nullopt : store_retry_at_; }

  /// Returns true if another gateway takes robots in and configures them.
  bool is_guest() const { return database() != nullptr && database()->guest_address; }
  /// Returns true if other gateways have radios in this mesh.
  bool is_shared() const { return is_guest() || (database() && !database()->gateways.empty()); }
  const Node* find(const Uuid& uuid) const { return database() ? database()->find(uuid) : nullptr; }
  /// Returns the node that has this address on any of its elements, or null.
  const Node* find(std::uint16_t address) const {
    return database() ? database()->find_address(address) : nullptr;
  }
  /// Returns the same, but null for a node that has not joined yet.
  const Node* find_joined(std::uint16_t address) const;

  /// A node, or its name, has changed.
  void announce_change() { is_change_announced_ = true; }
  /// Returns true once after such a change.
  bool take_change() { return std::exchange(is_change_announced_, false); }
  /// Removes the node, which joins again only on an operator's order.
  void remove(Uuid uuid);

  void on_names(RobotNames names) { names_ = std::move(names); }
  const RobotNames& names() const { return names_; }
  /// Returns the name of the robot with this unicast address. The configuration's name counts
  /// unless another node has it.
  std::string id_of(std::uint16_t address) const;
  /// Returns true if a joined node at another address has this name.
  bool is_elsewhere(const std::string& id, std::uint16_t address) const;
  /// Returns the name that the configuration gives to this address, or null.
  const std::string* configured_name(std::uint16_t address) const;

  /// A message came from this unicast address.
  void on_heard(std::uint16_t address, TimePoint now);
  NodeHistory& history(const Uuid& uuid) { return histories_[uuid]; }
  /// Returns null if nothing has happened to the node yet.
  const NodeHistory* find_history(const Uuid& uuid) const;

  /// Returns the addresses of gateways, used or not yet, and of robots that another tool took in.
  std::set<std::uint16_t> taken_addresses() const;
  /// Returns how many addresses the gateway at `gateway` has for its radio's lives, at least one.
  std::uint16_t room_at(std::uint16_t gateway) const;
  /// Returns the same for this gateway.
  std::uint16_t source_room() const;
  /// Returns true if this gateway's radio has sent from the address, and no robot is known there.
  bool is_own(std::uint16_t address) const;
  /// Returns an address for a new robot, or for one that was reset by hand. `name` was given by an
  /// operator and may be empty.
  std::optional<std::uint16_t> address_for(const Uuid& uuid, std::uint8_t elements,
                                           const std::string& name) const;
  /// Returns an address for another gateway (`ble export`), where most free addresses follow.
  std::optional<std::uint16_t> address_for_gateway() const;

  /// Returns the answer to `slam-gatewayctl ble nodes`.
  std::string json() const;
  std::string json(const Node& node) const;

 private:
  /// Returns the joined node that keeps this name, which `robots` gives to `address`, or null. A
  /// node keeps its operator's name if `robots` gives it no other, or one that a node keeps.
  const Node* holder_of(const std::string& name, std::uint16_t address) const;

  const Settings& settings_;
  RobotNames names_;
  std::optional<NodeDatabase> database_;
  bool is_changed_ = false;
  bool is_writing_ = false;
  bool is_beginning_ = false;  ///< `database_` is a new mesh that is not on disk yet
  std::optional<TimePoint> store_retry_at_;
  bool is_change_announced_ = false;
  std::map<Uuid, NodeHistory> histories_;
  /// Heard addresses that are not nodes', and how often each was heard, up to believed_after:
  /// robots that another tool has taken in. At most NodeDatabase::max_nodes.
  std::map<std::uint16_t, int> strangers_;
};

}  // namespace slamgw::ble
