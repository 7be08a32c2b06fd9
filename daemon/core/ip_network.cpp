// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/ip_network.hpp"
#include "daemon/core/parse_number.hpp"

#include <arpa/inet.h>

#include <algorithm>
#include <string>

namespace slamgw {
namespace {

constexpr unsigned address_bits = 128;
constexpr unsigned mapped_bits = 96;  // ::ffff:0:0/96 is IPv4

}  // namespace

std::optional<IpNetwork> IpNetwork::parse(std::string_view text) {
  const std::size_t slash = text.find('/');
  const std::string host(text.substr(0, slash));
  if (host.find('\0') != host.npos) return std::nullopt;
  IpNetwork network;
  const bool is_ipv6 = inet_pton(AF_INET6, host.c_str(), network.address.data()) == 1;
  if (!is_ipv6) {
    network.address[10] = network.address[11] = 0xff;
    if (inet_pton(AF_INET, host.c_str(), network.address.data() + 12) != 1) return std::nullopt;
  }
  if (slash == text.npos) return network;
  const auto length = parse_number<decltype(network.bits)>(text.substr(slash + 1));
  if (!length || *length > address_bits) return std::nullopt;
  network.bits = *length;
  if (!is_ipv6) network.bits += mapped_bits;
  if (network.bits > address_bits) return std::nullopt;
  for (unsigned bit = network.bits; bit < address_bits; ++bit)
    network.address[bit / 8] &= static_cast<std::uint8_t>(~(0x80U >> bit % 8));
  return network;
}

bool IpNetwork::covers(const Address& other) const {
  const unsigned whole = bits / 8;
  const unsigned rest = bits % 8;
  if (!std::equal(other.begin(), other.begin() + whole, address.begin())) return false;
  return rest == 0 || (other[whole] ^ address[whole]) >> (8 - rest) == 0;
}

}  // namespace slamgw
