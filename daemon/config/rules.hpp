// SPDX-License-Identifier: Apache-2.0
// The rules for texts in the configuration. Pure functions on strings, used by the schema's rows.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "daemon/mqtt/settings.hpp"

namespace slamgw {

bool is_gateway_id(std::string_view text);    ///< `[A-Za-z0-9_-]{1,32}`
bool is_client_id(std::string_view text);     ///< 1-255 octets of UTF-8, no control characters
bool is_topic_prefix(std::string_view text);  ///< levels that are not empty, no leading `$`
bool is_uuid_prefix(std::string_view text);   ///< 1-32 hex digits
bool is_static_oob(std::string_view text);    ///< 32 hex digits
bool is_interface_name(std::string_view text);
bool is_listen_address(
    std::string_view text);  ///< `0.0.0.0:47193`, `[::]:47193`, `[fe80::1%wpan0]:0`
/// Splits a text that is_listen_address() accepts: the address without brackets, and the port.
std::pair<std::string, std::uint16_t> listen_parts(std::string_view listen);
/// `robot/+/update`, or with one robot's id in place of `+`.
bool is_relay_filter(std::string_view text);
bool is_host_name(std::string_view text);        ///< letters, digits, `-` and `.`, 1-253 characters
bool is_multicast_group(std::string_view text);  ///< an IPv4 or IPv6 multicast address

/// Makes a gateway id of a host name: other characters become `-`, an empty name `gateway`.
std::string gateway_id_of_host(std::string_view host_name);

/// Returns what `broker.client_id` is unless it is set.
std::string default_client_id(const std::string& gateway_id);

/// Parses `mqtt://host[:port]` or `mqtts://host[:port]`; nothing for any other text.
std::optional<BrokerAddress> parse_broker_uri(std::string_view uri);

}  // namespace slamgw
