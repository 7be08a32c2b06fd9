// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/io/network_interfaces.hpp"

#include <ifaddrs.h>
#include <net/if.h>
#include <netinet/in.h>

#include <algorithm>
#include <cstring>
#include <memory>
#include <optional>

namespace slamgw::mqttsn {
namespace {

struct FreeInterfaces {
  void operator()(ifaddrs* first) const { freeifaddrs(first); }
};

/// Nothing for what is no IP address.
std::optional<IpAddress> read_address(const sockaddr& from) {
  IpAddress address{};
  if (from.sa_family == AF_INET6) {
    sockaddr_in6 v6{};
    std::memcpy(&v6, &from, sizeof v6);
    std::memcpy(address.data(), &v6.sin6_addr, address.size());
    return address;
  }
  if (from.sa_family != AF_INET) return std::nullopt;
  sockaddr_in v4{};
  std::memcpy(&v4, &from, sizeof v4);
  address[10] = address[11] = 0xff;
  std::memcpy(address.data() + 12, &v4.sin_addr, 4);
  return address;
}

NetworkInterface& entry(std::vector<NetworkInterface>& interfaces, const ifaddrs& of) {
  const auto known =
      std::find_if(interfaces.begin(), interfaces.end(),
                   [&](const NetworkInterface& other) { return other.name == of.ifa_name; });
  if (known != interfaces.end()) return *known;
  NetworkInterface added;
  added.index = if_nametoindex(of.ifa_name);
  added.name = of.ifa_name;
  added.is_loopback = (of.ifa_flags & IFF_LOOPBACK) != 0;
  added.takes_multicast =
      (of.ifa_flags & IFF_UP) != 0 && (of.ifa_flags & (IFF_MULTICAST | IFF_LOOPBACK)) != 0;
  added.has_carrier = (of.ifa_flags & IFF_RUNNING) != 0;
  return interfaces.emplace_back(std::move(added));
}

}  // namespace

std::vector<NetworkInterface> read_network_interfaces() {
  std::vector<NetworkInterface> interfaces;
  ifaddrs* first = nullptr;
  if (getifaddrs(&first) != 0) return interfaces;
  const std::unique_ptr<ifaddrs, FreeInterfaces> all(first);
  for (const ifaddrs* i = first; i; i = i->ifa_next) {
    NetworkInterface& interface = entry(interfaces, *i);
    const auto address = i->ifa_addr ? read_address(*i->ifa_addr) : std::nullopt;
    if (address) interface.addresses.push_back(*address);
  }
  // One that vanished meanwhile has no index any more.
  std::erase_if(interfaces, [](const NetworkInterface& gone) { return gone.index == 0; });
  return interfaces;
}

}  // namespace slamgw::mqttsn
