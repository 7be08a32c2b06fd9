// SPDX-License-Identifier: Apache-2.0
// The facts about a BLE mesh that the gateway must not lose: keys, and addresses with their owners.
// Values and lookups only; mesh_json.hpp gives them their form in `mesh.json`, mesh_file.hpp their
// place on disk. Holds secrets: never printed, never in a Notice.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/radio.hpp"
#include "daemon/core/operator_order.hpp"

namespace slamgw::ble {

inline constexpr std::uint8_t max_elements = 255;  ///< of one node

/// Maximum of addresses for the lives of forgetful radios: each life gets the next one, from the
/// gateway's own up. A robot's replay list has 40 places, which other senders need too, and a robot
/// with a full list hears no new sender.
inline constexpr std::uint16_t max_sources = 32;

/// Reads 32 hex digits, hyphens allowed.
std::optional<Uuid> parse_uuid(std::string_view text);

/// Returns text such as `0x0100`, as in files and answers.
std::string address_text(std::uint16_t address);

/// A robot's progress on its way into the mesh.
enum class NodeState : std::uint8_t {
  reserved,     ///< has an address, which the device may not have taken
  provisioned,  ///< its device key is known
  configured,   ///< has its whole configuration
};
std::string_view to_string(NodeState state);

/// The configuration that a node has besides the TTL.
struct AppliedSettings {
  std::uint16_t destination = 0;  ///< where it publishes to: a gateway, or a group of gateways
  std::vector<std::uint16_t> groups;
  bool is_changing = false;                       ///< under change: the node may have parts of both
  std::optional<std::uint16_t> relay_group = {};  ///< in which it hears relayed updates
};

/// An operator's settings for one robot (`ble config`). An empty TTL is that of all robots; other
/// empty members leave the node's values as they are.
struct NodeWishes {
  std::optional<std::uint8_t> ttl = {};  ///< of its publications, and its default TTL
  std::optional<bool> relay = {};
  std::optional<Transmissions> transmit = {};  ///< of each packet of its own
  std::vector<std::uint16_t> groups = {};      ///< to hear beside those of all; at most max_groups
  static constexpr std::size_t max_groups = 8;
  /// Destinations of publications, by the model's id as text; at most one for each of `publishers`.
  std::map<std::string, std::uint16_t> publications = {};
  bool operator==(const NodeWishes&) const = default;
};

/// The steps of a key refresh (Mesh Profile 1.0 section 3.10.4), each for all nodes. A step is on
/// disk before any message of it is sent.
enum class RefreshStep : std::uint8_t {
  none,
  distributing,  ///< nodes get the new keys, and hear both; they send under the old ones
  switching,     ///< they send under the new ones
  finishing,     ///< they forget the old ones, which the radio does not have any more
};
std::string_view to_string(RefreshStep step);

/// A key refresh that is under way. Holds secrets.
struct RefreshState {
  RefreshStep step = RefreshStep::distributing;
  MeshKeys other;  ///< the new keys; while finishing, the old ones
};

struct Node {
  Uuid uuid{};
  std::uint16_t address = 0;  ///< unicast, of the first element
  std::uint8_t elements = 1;  ///< their addresses follow each other
  NodeState state = NodeState::reserved;
  /// Set before the device gets its address, until the outcome is known.
  bool is_joining = false;
  std::optional<Key> device_key = {};    ///< empty while `reserved`, or if the radio keeps it
  std::string name = {};                 ///< given by an operator; may be empty
  std::optional<std::uint8_t> ttl = {};  ///< configured for its publications
  /// Empty: not configured, or configured by another tool or an old version.
  std::optional<AppliedSettings> applied = {};
  /// The address at which the node joins again after a reset by hand; 0: none. The node has both
  /// addresses until it has joined.
  std::uint16_t new_address = 0;
  std::uint8_t new_elements = 0;  ///< the number of its addresses from `new_address` up
  NodeWishes wishes = {};
  /// The last step that the node has taken in the key refresh under way.
  RefreshStep refreshed = RefreshStep::none;

  /// Returns the address that the device gets when it joins.
  std::uint16_t joining_address() const { return new_address != 0 ? new_address : address; }
  /// Returns how many addresses it gets from there up.
  std::uint8_t joining_elements() const { return new_address != 0 ? new_elements : elements; }
  /// Returns the TTL that the node publishes with; nothing if unknown.
  std::optional<std::uint8_t> sent_ttl() const {
    return applied && applied->is_changing ? std::nullopt : ttl;
  }

  bool has_address(std::uint16_t other) const {
    return other >= address && other - address < elements;
  }
};

/// A node that was removed from the mesh. Its address is used again after all others, and the
/// device joins again only on an operator's order.
struct RemovedNode {
  Uuid uuid{};  ///< zeros: the device may join again
  std::uint16_t address = 0;
  std::uint8_t elements = 1;
};

/// A radio's memory over a power-off, as far as it was seen.
enum class RadioKind : std::uint8_t { unknown, forgets, keeps };
std::string_view to_string(RadioKind kind);

/// One life of a radio lasts as long as it keeps its sequence numbers.
struct RadioLife {
  std::uint32_t number = 0;  ///< counts the lives from 1; 0: no radio was used yet
  /// The last address that was given to a life; 0: unknown.
  std::uint16_t source = 0;
  std::string radio = {};  ///< the last radio, as in LinkIsUp
  RadioKind kind = RadioKind::unknown;
  bool operator==(const RadioLife&) const = default;
};

struct NodeDatabase {
  /// As many as BleMesh has room for; a stock serial board hears 40 (its replay list).
  static constexpr std::size_t max_nodes = 256;
  /// Beyond this, the oldest are forgotten. `next_address` still keeps their addresses back.
  static constexpr std::size_t max_removed = 256;

  MeshKeys keys;
  std::uint32_t iv_index = 0;
  std::uint16_t next_address = 0x0100;    ///< no address from here up was handed out in order
  std::vector<Node> nodes = {};           ///< in the order in which they came
  std::vector<RemovedNode> removed = {};  ///< oldest first
  /// Unicast addresses of other gateways in this mesh (`ble export`).
  std::vector<std::uint16_t> gateways = {};
  /// Set if another gateway provisions this mesh: the unicast address that it gave this gateway.
  std::optional<std::uint16_t> guest_address = {};
  /// The number of this gateway's addresses, from `guest_address` up.
  std::uint16_t guest_addresses = 1;
  RadioLife life = {};
  std::string host = {};  ///< `gateway.id` of the gateway that provisions the mesh; may be empty
  std::optional<RefreshState> refresh = {};

  Node* find(const Uuid& uuid);
  const Node* find(const Uuid& uuid) const;
  /// The node that has this address on any of its elements.
  const Node* find_address(std::uint16_t address) const;
  bool was_removed(const Uuid& uuid) const;
  /// Removes the node and remembers that.
  void remove(Uuid uuid);
  /// The address is used again after all others. The device `uuid` joins only on an operator's
  /// order; zeros for none.
  void retire(std::uint16_t address, std::uint8_t elements, const Uuid& uuid);
  /// The device may join again; its address stays retired.
  void forget_removed(const Uuid& uuid);
};

/// Returns the keys for the radio. While they are distributed, the radio has the old ones only: no
/// node sends under the new ones yet.
RadioKeys radio_keys(const NodeDatabase& database);
/// Returns the same; nothing without a mesh.
inline std::optional<RadioKeys> radio_keys(const std::optional<NodeDatabase>& database) {
  return database ? std::optional(radio_keys(*database)) : std::nullopt;
}

// The choice of a new robot's unicast address, in this order: the addresses that `robots` names, as
// they stand there; the next free one from 0x0100; one that was passed over; at last the one whose
// robot was removed longest ago, because the other nodes' replay lists may still know it.

inline constexpr std::uint16_t first_robot_address = 0x0100;

struct AddressWish {
  std::uint8_t elements = 1;
  std::vector<std::uint16_t> preferred;
  /// Addresses of gateways, and of robots that another tool has taken in.
  std::set<std::uint16_t> taken;
};

/// Returns nothing if no free range of this size is left.
std::optional<std::uint16_t> choose_address(const NodeDatabase& database, const AddressWish& wish);
/// Returns true if the address is free for the node `own`, or for a new node without `own`.
bool is_address_free(const NodeDatabase& database, std::uint16_t address, std::uint8_t elements,
                     const std::set<std::uint16_t>& taken, const std::optional<Uuid>& own);
/// Returns how many addresses from `address` up a gateway can have for the lives of its radio, at
/// most `max_sources`. A node's address, one in `taken` or, from below, the range for robots ends
/// the row.
std::uint16_t source_room(const NodeDatabase& database, std::uint16_t address,
                          const std::set<std::uint16_t>& taken);
/// Returns true if an earlier node had the address: the radio's replay list may still know it.
bool was_used_before(const NodeDatabase& database, std::uint16_t address, std::uint8_t elements);

}  // namespace slamgw::ble
