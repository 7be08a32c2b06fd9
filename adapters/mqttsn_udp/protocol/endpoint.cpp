// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/protocol/endpoint.hpp"

#include <arpa/inet.h>
#include <fmt/format.h>

#include <functional>
#include <string_view>

#include "daemon/core/bytes.hpp"

namespace slamgw::mqttsn {
namespace {

std::string address_text(const Endpoint& endpoint) {
  const IpAddress& a = endpoint.address;
  if (is_ipv4(a)) return fmt::format("{}.{}.{}.{}", a[12], a[13], a[14], a[15]);
  char text[INET6_ADDRSTRLEN] = {};
  inet_ntop(AF_INET6, a.data(), text, sizeof text);
  const std::string scope =
      endpoint.scope_id == 0 ? std::string() : fmt::format("%{}", endpoint.scope_id);
  return fmt::format("[{}{}]", text, scope);
}

}  // namespace

std::size_t PeerHash::operator()(const Peer& peer) const {
  const std::hash<std::string_view> hash;
  const Endpoint& e = peer.endpoint;
  const std::size_t ports = (std::size_t{e.scope_id} << 16) ^ e.port;
  return hash(as_text(e.address)) ^ (ports * static_cast<std::size_t>(0x9e3779b97f4a7c15U)) ^
         (hash(peer.node_id) << 1);
}

std::string to_string(const Peer& peer) {
  std::string text = fmt::format("{}:{}", address_text(peer.endpoint), peer.endpoint.port);
  if (!peer.node_id.empty()) text += " via node " + to_hex(as_bytes(peer.node_id));
  return text;
}

}  // namespace slamgw::mqttsn
