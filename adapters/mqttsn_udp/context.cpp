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
  tally.count(Count::datagrams_out);
  actions_.push(SendDatagram{from, to.endpoint, std::move(bytes)});
}

bool Context::fits(const ClientSession& session, std::size_t octets) const {
  const bool is_forwarded = session.peer && !session.peer->node_id.empty();
  const std::size_t header = is_forwarded ? 3 + session.peer->node_id.size() : 0;
  const std::size_t long_length = octets > 255 ? 2 : 0;
  return header + long_length + octets <= limits::max_datagram_octets;
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
