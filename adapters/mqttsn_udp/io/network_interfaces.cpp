// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/io/network_interfaces.hpp"

#include <ifaddrs.h>
#include <net/if.h>

#include <algorithm>
#include <memory>

#include "adapters/mqttsn_udp/io/udp_socket.hpp"
#include "daemon/core/freed_by.hpp"

namespace slamgw::mqttsn {
namespace {

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
  const std::unique_ptr<ifaddrs, FreedBy<freeifaddrs>> all(first);
  for (const ifaddrs* i = first; i; i = i->ifa_next) {
    NetworkInterface& interface = entry(interfaces, *i);
    const int family = i->ifa_addr ? i->ifa_addr->sa_family : AF_UNSPEC;
    if (family == AF_INET || family == AF_INET6)
      interface.addresses.push_back(from_sockaddr(*i->ifa_addr).address);
  }
  // An interface that has just vanished has no index any more.
  std::erase_if(interfaces, [](const NetworkInterface& gone) { return gone.index == 0; });
  return interfaces;
}

}  // namespace slamgw::mqttsn
