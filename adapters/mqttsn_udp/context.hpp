// SPDX-License-Identifier: Apache-2.0
// What all concerns of the gateway share: the configuration, the sessions, and the ways out.
// Decides nothing about the protocol.
#pragma once

#include <set>
#include <string>
#include <vector>

#include "adapters/mqttsn_udp/actions.hpp"
#include "adapters/mqttsn_udp/clients/address_validation.hpp"
#include "adapters/mqttsn_udp/clients/client_table.hpp"
#include "adapters/mqttsn_udp/clients/predefined_topics.hpp"
#include "adapters/mqttsn_udp/protocol/packet.hpp"
#include "adapters/mqttsn_udp/settings.hpp"
#include "adapters/mqttsn_udp/tally.hpp"
#include "daemon/core/protocol_machine.hpp"
#include "daemon/core/robot_names.hpp"
#include "daemon/core/topic_scheme.hpp"

namespace slamgw::mqttsn {

class Context {
 public:
  Context(Settings settings_, TopicPolicy policy_, RobotNames names_);

  const Settings settings;
  TopicPolicy policy;  ///< these two may change (SnGateway::reconfigure)
  RobotNames names;
  const PredefinedTopics predefined;
  ClientTable clients;
  AddressValidation validation;
  Tally tally;
  bool is_traced = false;  ///< every MeshStep is told, or only repeats

  bool is_validated(const ClientSession& session) const;
  /// Whether a message of `octets` (with the 1-octet Length) may go to this client now.
  bool may_send(const ClientSession& session, std::size_t octets) const;
  /// To where the client was last heard; nothing when it has no address, or when the address has
  /// not shown that it receives and was sent as much as came from it.
  void send(const ClientSession& session, const Packet& packet);
  /// `radius` only matters behind a forwarder (R140).
  void send(const Peer& to, const LocalAddress& from, const Packet& packet,
            std::uint8_t radius = 0);
  /// Whether the network carries a message of `octets` (with the 1-octet Length) to this client
  /// (R8).
  bool fits(const ClientSession& session, std::size_t octets) const;
  /// On every interface, or on the one with this index.
  void send_multicast(const Packet& packet, std::uint32_t interface = 0);
  void emit(MeshEvent event) { actions_.push(std::move(event)); }
  std::optional<Action> next_action() { return actions_.pop(); }

  /// Something that must survive a restart has changed.
  void set_dirty(const ClientSession& session);
  bool has_dirty() const { return !dirty_.empty(); }
  /// At most `max`.
  std::vector<std::string> take_dirty(std::size_t max);

  bool is_full_silent() const { return settings.when_full == WhenFull::silent; }

 private:
  static std::size_t overhead(const ClientSession& session, std::size_t octets);

  ActionQueue<Action> actions_;
  std::set<std::string> dirty_;  // at most max_dirty
};

}  // namespace slamgw::mqttsn
