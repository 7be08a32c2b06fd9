// SPDX-License-Identifier: Apache-2.0
// The ways out of the machine: datagrams, as many octets as an address may be sent, and events.
// Decides nothing about the protocol.
#pragma once

#include "adapters/mqttsn_udp/actions.hpp"
#include "adapters/mqttsn_udp/clients/address_validation.hpp"
#include "adapters/mqttsn_udp/clients/client_session.hpp"
#include "adapters/mqttsn_udp/protocol/packet.hpp"
#include "adapters/mqttsn_udp/tally.hpp"
#include "daemon/core/protocol_machine.hpp"

namespace slamgw::mqttsn {

class Output {
 public:
  explicit Output(Tally& tally) : tally_(tally) {}

  AddressValidation validation;
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

 private:
  static std::size_t overhead(const ClientSession& session, std::size_t octets);

  Tally& tally_;
  ActionQueue<Action> actions_;
};

}  // namespace slamgw::mqttsn
