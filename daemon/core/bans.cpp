// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/bans.hpp"

#include <arpa/inet.h>

#include <algorithm>
#include <charconv>
#include <optional>

#include "daemon/core/topic_scheme.hpp"

namespace slamgw {
namespace {

constexpr unsigned address_bits = 128;
constexpr unsigned mapped_bits = 96;  // ::ffff:0:0/96 is IPv4

struct Parsed {
  Bans::Address address{};
  unsigned bits = address_bits;
};

std::optional<Parsed> parse_network(std::string_view entry) {
  const std::size_t slash = entry.find('/');
  const std::string host(entry.substr(0, slash));
  if (host.find('\0') != host.npos) return std::nullopt;
  Parsed parsed;
  const bool is_ipv6 = inet_pton(AF_INET6, host.c_str(), parsed.address.data()) == 1;
  if (!is_ipv6) {
    parsed.address[10] = parsed.address[11] = 0xff;
    if (inet_pton(AF_INET, host.c_str(), parsed.address.data() + 12) != 1) return std::nullopt;
  }
  if (slash == entry.npos) return parsed;
  const std::string_view length = entry.substr(slash + 1);
  const auto [end, error] =
      std::from_chars(length.data(), length.data() + length.size(), parsed.bits);
  if (error != std::errc{} || end != length.data() + length.size()) return std::nullopt;
  if (!is_ipv6) parsed.bits += mapped_bits;
  return parsed.bits <= address_bits ? std::optional(parsed) : std::nullopt;
}

}  // namespace

Bans::Bans(const std::vector<std::string>& entries) {
  for (const std::string& entry : entries) {
    if (const auto network = parse_network(entry)) {
      networks_.push_back({network->address, network->bits});
    } else if (is_valid_level(entry)) {
      ids_.insert(entry);
    }
  }
}

bool Bans::is_valid(std::string_view entry) {
  return parse_network(entry) || is_valid_level(entry);
}

bool Bans::covers(const Address& address) const {
  return std::ranges::any_of(networks_, [&](const Network& network) {
    const unsigned whole = network.bits / 8;
    const unsigned rest = network.bits % 8;
    if (!std::equal(address.begin(), address.begin() + whole, network.address.begin()))
      return false;
    return rest == 0 || (address[whole] ^ network.address[whole]) >> (8 - rest) == 0;
  });
}

}  // namespace slamgw
