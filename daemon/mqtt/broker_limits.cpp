// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/broker_limits.hpp"

#include <fmt/format.h>

namespace slamgw {
namespace {

/// Returns the size of a Variable Byte Integer (MQTT 5 section 1.5.5).
std::size_t length_field_bytes(std::size_t value) {
  std::size_t bytes = 1;
  for (; value >= 0x80; value >>= 7) ++bytes;
  return bytes;
}

}  // namespace

std::string to_words(const BrokerLimits& limits) {
  std::string words;
  if (limits.max_packet_bytes)
    words += fmt::format(", packets up to {} octets", *limits.max_packet_bytes);
  if (limits.max_qos != Qos::exactly_once)
    words += fmt::format(", QoS up to {}", static_cast<int>(limits.max_qos));
  if (!limits.keeps_retained) words += ", no retained messages";
  if (!limits.takes_wildcards) words += ", no subscriptions with wildcards";
  return words.empty() ? words : words.substr(2);
}

std::size_t publish_packet_bytes(const BrokerMessage& message,
                                 std::optional<std::size_t> property_bytes) {
  std::size_t rest = 2 + message.topic.size() + message.payload.size();
  if (message.qos != Qos::at_most_once) rest += 2;  // the packet identifier
  if (property_bytes) rest += length_field_bytes(*property_bytes) + *property_bytes;
  return 1 + length_field_bytes(rest) + rest;
}

}  // namespace slamgw
