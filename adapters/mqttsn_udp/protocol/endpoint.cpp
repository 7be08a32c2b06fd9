// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/protocol/endpoint.hpp"

#include <arpa/inet.h>
#include <fmt/format.h>

#include <algorithm>
#include <functional>
#include <string_view>

#include "daemon/core/bytes.hpp"

namespace slamgw::mqttsn {

namespace {

constexpr std::ptrdiff_t prefix_octets = 8;  // of Thread's mesh-local prefix

bool has_link_local_scope(const IpAddress& to) {
  constexpr std::uint8_t link_local_scope = 2;  // RFC 4291 section 2.7
  return to[0] == 0xff ? (to[1] & 0x0f) == link_local_scope : is_link_local(to);
}

/// Returns true for an endpoint identifier: an address with the prefix of the locators.
bool is_mesh_local(const IpAddress& address, const std::vector<IpAddress>& candidates) {
  return std::any_of(candidates.begin(), candidates.end(), [&](const IpAddress& other) {
    return is_thread_locator(other) && !is_link_local(other) &&
           std::equal(other.begin(), other.begin() + prefix_octets, address.begin());
  });
}

/// Leading octets in common: enough to prefer the client's own prefix.
std::ptrdiff_t common_octets(const IpAddress& a, const IpAddress& b) {
  return std::mismatch(a.begin(), a.end(), b.begin()).first - a.begin();
}

}  // namespace

bool is_ipv4(const IpAddress& address) {
  constexpr std::array<std::uint8_t, 12> prefix = {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xff, 0xff};
  return std::equal(prefix.begin(), prefix.end(), address.begin());
}

bool is_multicast(const IpAddress& address) {
  return address[0] == 0xff || (is_ipv4(address) && (address[12] & 0xf0) == 0xe0) ||
         (is_ipv4(address) && address[12] == 0xff);  // 255.255.255.255
}

bool is_link_local(const IpAddress& address) {
  return address[0] == 0xfe && (address[1] & 0xc0) == 0x80;
}

IpAddress network_of(IpAddress address) {
  if (!is_ipv4(address)) std::fill(address.begin() + 8, address.end(), std::uint8_t{0});
  return address;
}

bool is_thread_locator(const IpAddress& address) {
  constexpr std::array<std::uint8_t, 6> locator = {0, 0, 0, 0xff, 0xfe, 0};
  return std::equal(locator.begin(), locator.end(), address.begin() + 8);
}

std::optional<IpAddress> choose_source(const std::vector<IpAddress>& candidates,
                                       const IpAddress& to) {
  const auto rank = [&](const IpAddress& candidate) {
    const bool is_preferred = is_multicast(to) && is_mesh_local(candidate, candidates);
    return is_preferred ? std::ptrdiff_t{17} : common_octets(candidate, to);
  };
  std::optional<IpAddress> best;
  bool has_locator = false;
  for (const IpAddress& candidate : candidates) {
    has_locator |= is_thread_locator(candidate) && !is_link_local(candidate);
    const bool fits = is_ipv4(candidate) == is_ipv4(to) && !is_thread_locator(candidate) &&
                      is_link_local(candidate) == has_link_local_scope(to);
    if (fits && (!best || rank(candidate) > rank(*best))) best = candidate;
  }
  if (!best && (!has_locator || is_ipv4(to) || has_link_local_scope(to))) return IpAddress{};
  return best;
}

namespace {

std::string address_text(const Endpoint& endpoint) {
  if (is_ipv4(endpoint.address)) return to_string(endpoint.address);
  const std::string scope =
      endpoint.scope_id == 0 ? std::string() : fmt::format("%{}", endpoint.scope_id);
  return fmt::format("[{}{}]", to_string(endpoint.address), scope);
}

}  // namespace

std::size_t PeerHash::operator()(const Peer& peer) const {
  const std::hash<std::string_view> hash;
  const Endpoint& e = peer.endpoint;
  const std::size_t ports = (std::size_t{e.scope_id} << 16) ^ e.port;
  return hash(as_text(e.address)) ^ (ports * static_cast<std::size_t>(0x9e3779b97f4a7c15U)) ^
         (hash(peer.node_id) << 1) ^ (hash(peer.identity) << 2);
}

std::string to_string(const IpAddress& a) {
  if (is_ipv4(a)) return fmt::format("{}.{}.{}.{}", a[12], a[13], a[14], a[15]);
  char text[INET6_ADDRSTRLEN] = {};
  inet_ntop(AF_INET6, a.data(), text, sizeof text);
  return text;
}

std::string to_string(const Peer& peer) {
  std::string text = fmt::format("{}:{}", address_text(peer.endpoint), peer.endpoint.port);
  if (!peer.node_id.empty()) text += " via node " + to_hex(as_bytes(peer.node_id));
  if (!peer.identity.empty()) text += " over DTLS";
  return text;
}

}  // namespace slamgw::mqttsn
