// SPDX-License-Identifier: Apache-2.0
#include "daemon/config/rules.hpp"

#include <arpa/inet.h>
#include <netinet/in.h>

#include <algorithm>

#include "daemon/core/parse_number.hpp"
#include "daemon/core/topic_scheme.hpp"
#include "daemon/core/utf8.hpp"

namespace slamgw {
namespace {

constexpr std::size_t max_gateway_id = 32;
constexpr std::size_t max_client_id = 255;
constexpr std::size_t max_prefix = 128;
constexpr std::size_t max_host_name = 253;  // RFC 1035
constexpr std::size_t uuid_digits = 32;

bool is_one_of(char c, std::string_view extra) {
  return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
         extra.find(c) != std::string_view::npos;
}

bool all_of(std::string_view text, std::string_view extra) {
  return std::all_of(text.begin(), text.end(), [extra](char c) { return is_one_of(c, extra); });
}

bool is_hex(std::string_view text) {
  return text.find_first_not_of("0123456789abcdefABCDEF") == std::string_view::npos;
}

bool is_ipv4(const std::string& text, in_addr& address) {
  return text.find('\0') == text.npos && inet_pton(AF_INET, text.c_str(), &address) == 1;
}

bool is_ipv6(const std::string& text, in6_addr& address) {
  return text.find('\0') == text.npos && inet_pton(AF_INET6, text.c_str(), &address) == 1;
}

/// `host:port` or `[host]:port`; the port is optional.
struct Authority {
  std::string host;
  bool is_bracketed = false;
  std::optional<std::string_view> port;
};

std::optional<Authority> split_authority(std::string_view text) {
  Authority result;
  std::size_t host_end = text.find(':');
  result.is_bracketed = text.starts_with('[');
  if (result.is_bracketed) {
    const std::size_t bracket = text.find(']');
    if (bracket == std::string_view::npos) return std::nullopt;
    result.host = text.substr(1, bracket - 1);
    host_end = bracket + 1;
    if (host_end < text.size() && text[host_end] != ':') return std::nullopt;
  } else {
    result.host = text.substr(0, host_end);
  }
  if (host_end < text.size()) result.port = text.substr(host_end + 1);
  return result;
}

/// A text of digits and dots must be an IPv4 address: "1.2.3" is a mistake, not a name.
bool is_host(const std::string& host) {
  in_addr address{};
  if (host.find_first_not_of("0123456789.") == std::string::npos) return is_ipv4(host, address);
  return host.size() <= max_host_name && all_of(host, ".-_") && host.front() != '-' &&
         host.front() != '.';
}

}  // namespace

bool is_gateway_id(std::string_view text) {
  return !text.empty() && text.size() <= max_gateway_id && all_of(text, "_-");
}

bool is_client_id(std::string_view text) {
  return !text.empty() && text.size() <= max_client_id && is_mqtt_text(text);
}

bool is_topic_prefix(std::string_view text) {
  if (text.size() > max_prefix || text.starts_with('$')) return false;
  while (true) {
    const std::size_t slash = text.find('/');
    if (!is_valid_level(text.substr(0, slash))) return false;
    if (slash == std::string_view::npos) return true;
    text.remove_prefix(slash + 1);
  }
}

bool is_uuid_prefix(std::string_view text) {
  return !text.empty() && text.size() <= uuid_digits && is_hex(text);
}

bool is_static_oob(std::string_view text) { return text.size() == uuid_digits && is_hex(text); }

bool is_interface_name(std::string_view text) {
  return !text.empty() && text.size() < 16 /* IFNAMSIZ */ && text != "." && text != ".." &&
         std::none_of(text.begin(), text.end(), [](char c) {
           return c == '/' || c == ':' || static_cast<unsigned char>(c) <= 0x20;
         });
}

bool is_listen_address(std::string_view text) {
  const auto parts = split_authority(text);
  if (!parts || !parts->port || !parse_number<std::uint16_t>(*parts->port)) return false;
  in_addr ipv4{};
  if (!parts->is_bracketed) return is_ipv4(parts->host, ipv4);
  const std::size_t percent = parts->host.find('%');
  if (percent != std::string::npos && !is_interface_name(parts->host.substr(percent + 1)))
    return false;
  in6_addr ipv6{};
  return is_ipv6(parts->host.substr(0, percent), ipv6);
}

std::pair<std::string, std::uint16_t> listen_parts(std::string_view listen) {
  const auto parts = split_authority(listen);
  return {parts->host, parse_number<std::uint16_t>(*parts->port).value_or(0)};
}

bool is_relay_filter(std::string_view text) {
  constexpr std::string_view head = "robot/";
  constexpr std::string_view tail = "/update";
  if (text.size() < head.size() + tail.size()) return false;
  if (!text.starts_with(head) || !text.ends_with(tail)) return false;
  const std::string_view robot = text.substr(head.size(), text.size() - head.size() - tail.size());
  return robot == "+" || is_valid_level(robot);
}

bool is_host_name(std::string_view text) {
  return !text.empty() && text.size() <= max_host_name && text.front() != '.' && all_of(text, "-.");
}

bool is_multicast_group(std::string_view text) {
  in_addr ipv4{};
  in6_addr ipv6{};
  const std::string address(text);
  if (is_ipv4(address, ipv4)) return (ntohl(ipv4.s_addr) >> 28) == 0xe;  // 224.0.0.0/4
  return is_ipv6(address, ipv6) && ipv6.s6_addr[0] == 0xff;
}

std::string gateway_id_of_host(std::string_view host_name) {
  std::string id(host_name.substr(0, max_gateway_id));
  std::replace_if(
      id.begin(), id.end(), [](char c) { return !is_one_of(c, "_-"); }, '-');
  return id.empty() ? "gateway" : id;
}

std::string default_client_id(const std::string& gateway_id) {
  return "slam-gateway-" + gateway_id;
}

std::optional<BrokerAddress> parse_broker_uri(std::string_view uri) {
  constexpr std::string_view plain = "mqtt://";
  constexpr std::string_view secure = "mqtts://";
  BrokerAddress result;
  result.tls = uri.starts_with(secure);
  if (!result.tls && !uri.starts_with(plain)) return std::nullopt;
  uri.remove_prefix(result.tls ? secure.size() : plain.size());
  const auto parts = split_authority(uri);
  if (!parts || parts->host.empty()) return std::nullopt;
  in6_addr ipv6{};
  if (parts->is_bracketed ? !is_ipv6(parts->host, ipv6) : !is_host(parts->host))
    return std::nullopt;
  const auto port = parts->port  ? parse_number<std::uint16_t>(*parts->port)
                    : result.tls ? 8883
                                 : 1883;
  if (!port || *port == 0) return std::nullopt;
  result.host = parts->host;
  result.port = *port;
  return result;
}

}  // namespace slamgw
