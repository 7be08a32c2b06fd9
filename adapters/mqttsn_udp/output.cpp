// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/output.hpp"

#include <utility>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

void Output::send(const ClientSession& session, const Packet& packet) {
  if (session.peer) send(*session.peer, session.local, packet);
}

void Output::send(const Peer& to, const LocalAddress& from, const Packet& packet,
                  std::uint8_t radius) {
  Bytes bytes = encode(packet);
  if (!to.node_id.empty()) bytes = encode_encapsulation(radius, to.node_id, bytes);
  if (!validation.may_send(to.endpoint.address, bytes.size()))
    return tally_.count(Count::unvalidated);
  validation.on_sent(to.endpoint.address, bytes.size());
  tally_.count(Count::datagrams_out);
  actions_.push(SendDatagram{from, to.endpoint, std::move(bytes)});
}

bool Output::is_validated(const ClientSession& session) const {
  return !session.peer || validation.is_validated(session.peer->endpoint.address);
}

bool Output::may_send(const ClientSession& session, std::size_t octets) const {
  return !session.peer ||
         validation.may_send(session.peer->endpoint.address, octets + overhead(session, octets));
}

bool Output::fits(const ClientSession& session, std::size_t octets) const {
  return octets + overhead(session, octets) <= limits::max_datagram_octets;
}

/// Of a forwarder's header and of the 3-octet Length.
std::size_t Output::overhead(const ClientSession& session, std::size_t octets) {
  const bool is_forwarded = session.peer && !session.peer->node_id.empty();
  const std::size_t header = is_forwarded ? 3 + session.peer->node_id.size() : 0;
  const std::size_t long_length = octets > 255 ? 2 : 0;
  return header + long_length;
}

void Output::send_multicast(const Packet& packet, std::uint32_t interface) {
  tally_.count(Count::datagrams_out);
  actions_.push(SendMulticast{encode(packet), interface});
}

}  // namespace slamgw::mqttsn
