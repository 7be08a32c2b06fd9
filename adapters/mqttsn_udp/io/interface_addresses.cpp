// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/io/interface_addresses.hpp"

#include <ifaddrs.h>
#include <net/if.h>
#include <netinet/in.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <memory>

namespace slamgw::mqttsn {
namespace {

struct FreeInterfaces {
  void operator()(ifaddrs* first) const { freeifaddrs(first); }
};
using Interfaces = std::unique_ptr<ifaddrs, FreeInterfaces>;

Interfaces read_interfaces() {
  ifaddrs* first = nullptr;
  if (getifaddrs(&first) != 0) return nullptr;
  return Interfaces(first);
}

bool is_ipv4(const IpAddress& address) {
  constexpr std::array<std::uint8_t, 12> prefix = {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xff, 0xff};
  return std::equal(prefix.begin(), prefix.end(), address.begin());
}

/// Leading bits in common, in octets: enough to prefer the client's own prefix.
std::size_t common_octets(const IpAddress& a, const IpAddress& b) {
  const auto [end, other] = std::mismatch(a.begin(), a.end(), b.begin());
  return static_cast<std::size_t>(end - a.begin());
}

}  // namespace

bool is_multicast(const IpAddress& address) {
  return address[0] == 0xff || (is_ipv4(address) && (address[12] & 0xf0) == 0xe0) ||
         (is_ipv4(address) && address[12] == 0xff);  // 255.255.255.255
}

bool is_thread_locator(const IpAddress& address) {
  constexpr std::array<std::uint8_t, 6> locator = {0, 0, 0, 0xff, 0xfe, 0};
  return std::equal(locator.begin(), locator.end(), address.begin() + 8);
}

bool is_link_local(const IpAddress& address) {
  return address[0] == 0xfe && (address[1] & 0xc0) == 0x80;
}

std::optional<IpAddress> choose_source(const std::vector<IpAddress>& candidates,
                                       const IpAddress& from) {
  std::optional<IpAddress> best;
  for (const IpAddress& candidate : candidates) {
    const bool fits = is_ipv4(candidate) == is_ipv4(from) && !is_thread_locator(candidate) &&
                      is_link_local(candidate) == is_link_local(from);
    if (!fits) continue;
    if (!best || common_octets(candidate, from) > common_octets(*best, from)) best = candidate;
  }
  return best;
}

std::uint32_t interface_index(const std::string& name) { return if_nametoindex(name.c_str()); }

std::vector<IpAddress> addresses_of_interface(std::uint32_t interface) {
  std::vector<IpAddress> addresses;
  const Interfaces all = read_interfaces();
  for (const ifaddrs* i = all.get(); i; i = i->ifa_next) {
    if (!i->ifa_addr || if_nametoindex(i->ifa_name) != interface) continue;
    IpAddress address{};
    if (i->ifa_addr->sa_family == AF_INET6) {
      sockaddr_in6 v6{};
      std::memcpy(&v6, i->ifa_addr, sizeof v6);
      std::memcpy(address.data(), &v6.sin6_addr, address.size());
    } else if (i->ifa_addr->sa_family == AF_INET) {
      sockaddr_in v4{};
      std::memcpy(&v4, i->ifa_addr, sizeof v4);
      address[10] = address[11] = 0xff;
      std::memcpy(address.data() + 12, &v4.sin_addr, 4);
    } else {
      continue;
    }
    addresses.push_back(address);
  }
  return addresses;
}

std::vector<std::uint32_t> multicast_interfaces(const std::string& name) {
  std::vector<std::uint32_t> indices;
  const Interfaces all = read_interfaces();
  for (const ifaddrs* i = all.get(); i; i = i->ifa_next) {
    const bool is_usable =
        (i->ifa_flags & IFF_UP) != 0 && (i->ifa_flags & (IFF_MULTICAST | IFF_LOOPBACK)) != 0;
    if (!is_usable || (!name.empty() && name != i->ifa_name)) continue;
    const std::uint32_t index = if_nametoindex(i->ifa_name);
    if (index != 0 && std::find(indices.begin(), indices.end(), index) == indices.end())
      indices.push_back(index);
  }
  return indices;
}

}  // namespace slamgw::mqttsn
