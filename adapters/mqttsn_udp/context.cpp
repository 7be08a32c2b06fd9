// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/context.hpp"

#include <utility>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

Context::Context(Settings settings_, TopicPolicy policy_, RobotNames names_)
    : settings(std::move(settings_)),
      policy(std::move(policy_)),
      names(std::move(names_)),
      predefined(settings.predefined_topics),
      clients(settings.max_clients) {}

void Context::send(const ClientSession& session, const Packet& packet) {
  if (session.peer) send(*session.peer, session.local, packet);
}

void Context::send(const Peer& to, const LocalAddress& from, const Packet& packet,
                   std::uint8_t radius) {
  Bytes bytes = encode(packet);
  if (!to.node_id.empty()) bytes = encode_encapsulation(radius, to.node_id, bytes);
  if (!validation.may_send(to.endpoint.address, bytes.size()))
    return tally.count(Count::unvalidated);
  validation.on_sent(to.endpoint.address, bytes.size());
  tally.count(Count::datagrams_out);
  actions_.push(SendDatagram{from, to.endpoint, std::move(bytes)});
}

bool Context::is_validated(const ClientSession& session) const {
  return !session.peer || validation.is_validated(session.peer->endpoint.address);
}

bool Context::may_send(const ClientSession& session, std::size_t octets) const {
  return !session.peer ||
         validation.may_send(session.peer->endpoint.address, octets + overhead(session, octets));
}

bool Context::fits(const ClientSession& session, std::size_t octets) const {
  return octets + overhead(session, octets) <= limits::max_datagram_octets;
}

/// Of a forwarder's header and of the 3-octet Length.
std::size_t Context::overhead(const ClientSession& session, std::size_t octets) {
  const bool is_forwarded = session.peer && !session.peer->node_id.empty();
  const std::size_t header = is_forwarded ? 3 + session.peer->node_id.size() : 0;
  const std::size_t long_length = octets > 255 ? 2 : 0;
  return header + long_length;
}

void Context::send_multicast(const Packet& packet, std::uint32_t interface) {
  tally.count(Count::datagrams_out);
  actions_.push(SendMulticast{encode(packet), interface});
}

void Context::set_dirty(const ClientSession& session) {
  if (dirty_.size() < limits::max_dirty) dirty_.insert(session.client_id);
}

std::vector<std::string> Context::take_dirty(std::size_t max) {
  std::vector<std::string> ids;
  while (!dirty_.empty() && ids.size() < max)
    ids.push_back(std::move(dirty_.extract(dirty_.begin()).value()));
  return ids;
}

}  // namespace slamgw::mqttsn
