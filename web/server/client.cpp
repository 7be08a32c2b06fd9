// SPDX-License-Identifier: Apache-2.0
#include "web/server/client.hpp"

#include <arpa/inet.h>

#include <algorithm>
#include <array>

namespace slamgw::web {

Client client_of(std::span<const unsigned char> address) {
  static constexpr std::array<unsigned char, 12> mapped{0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xff, 0xff};
  if (address.size() == 16 && std::equal(mapped.begin(), mapped.end(), address.begin()))
    address = address.subspan(mapped.size());
  std::array<char, INET6_ADDRSTRLEN> text{};
  if (address.size() == 4) {
    inet_ntop(AF_INET, address.data(), text.data(), text.size());
    return {text.data(), address[0] == 127};
  }
  in6_addr network{};
  std::copy_n(address.begin(), 64 / 8, network.s6_addr);
  inet_ntop(AF_INET6, &network, text.data(), text.size());
  const bool is_loopback = std::equal(address.begin(), address.end(), in6addr_loopback.s6_addr);
  return {is_loopback ? "::1" : std::string(text.data()) + "/64", is_loopback};
}

}  // namespace slamgw::web
