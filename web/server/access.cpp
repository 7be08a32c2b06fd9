// SPDX-License-Identifier: Apache-2.0
#include "web/server/access.hpp"

#include <arpa/inet.h>

#include <algorithm>
#include <boost/algorithm/string/case_conv.hpp>
#include <cstdint>
#include <locale>

#include "daemon/core/parse_number.hpp"

namespace slamgw::web {
namespace {

std::string lower(std::string_view text) {
  return boost::algorithm::to_lower_copy(std::string(text), std::locale::classic());
}

bool is_port(std::string_view text) { return parse_number<std::uint16_t>(text).has_value(); }

/// The name or address without its port; empty when `host` is not valid.
std::string name_of(std::string_view host) {
  if (host.starts_with('[')) {
    const std::size_t end = host.find(']');
    if (end == host.npos) return {};
    const std::string_view rest = host.substr(end + 1);
    if (!rest.empty() && (rest[0] != ':' || !is_port(rest.substr(1)))) return {};
    return std::string(host.substr(0, end + 1));
  }
  const std::size_t colon = host.find(':');
  if (colon != host.npos && !is_port(host.substr(colon + 1))) return {};
  return lower(host.substr(0, colon));
}

bool is_address(const std::string& name) {
  in_addr ipv4{};
  in6_addr ipv6{};
  if (name.starts_with('['))
    return inet_pton(AF_INET6, name.substr(1, name.size() - 2).c_str(), &ipv6) == 1;
  return inet_pton(AF_INET, name.c_str(), &ipv4) == 1;
}

}  // namespace

AccessRules::AccessRules(std::vector<std::string> hosts) {
  for (const std::string& host : hosts) hosts_.push_back(lower(host));
}

bool AccessRules::is_own_host(std::string_view host) const {
  const std::string name = name_of(host);
  return name == "localhost" || is_address(name) ||
         std::find(hosts_.begin(), hosts_.end(), name) != hosts_.end();
}

bool AccessRules::is_own_origin(std::string_view origin, std::string_view host) {
  if (origin.empty()) return true;
  const std::string asked = lower(host);
  const std::string from = lower(origin);
  return from == "http://" + asked || from == "https://" + asked;
}

}  // namespace slamgw::web
