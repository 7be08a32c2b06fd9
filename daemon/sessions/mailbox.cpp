// SPDX-License-Identifier: Apache-2.0
#include "daemon/sessions/mailbox.hpp"

#include <algorithm>
#include <chrono>

#include "daemon/core/topic_scheme.hpp"

namespace slamgw::sessions {
namespace {

constexpr std::size_t head_octets = 7;
constexpr std::uint32_t longest_age_ms = 3'600'000;

void put(Bytes& octets, std::uint32_t number, unsigned width) {
  for (unsigned shift = width * 8; shift > 0; shift -= 8)
    octets.push_back(static_cast<std::uint8_t>(number >> (shift - 8)));
}

std::uint32_t take(ByteView& octets, unsigned width) {
  std::uint32_t number = 0;
  for (const std::uint8_t octet : octets.first(width)) number = number << 8U | octet;
  octets = octets.subspan(width);
  return number;
}

}  // namespace

Bytes encode_waiting(const WaitingMessage& waiting) {
  const BrokerMessage& message = waiting.message;
  Bytes octets;
  octets.reserve(head_octets + message.topic.size() + message.payload.size());
  put(octets, std::min(message.waited.count(), longest_age_ms), 4);
  put(octets, static_cast<std::uint8_t>(message.qos), 1);
  put(octets, static_cast<std::uint16_t>(message.topic.size()), 2);
  octets.insert(octets.end(), message.topic.begin(), message.topic.end());
  octets.insert(octets.end(), message.payload.begin(), message.payload.end());
  return octets;
}

std::optional<BrokerMessage> decode_waiting(ByteView octets) {
  if (octets.size() < head_octets) return std::nullopt;
  BrokerMessage message;
  const std::uint32_t age_ms = take(octets, 4);
  const std::uint32_t qos = take(octets, 1);
  const std::uint32_t size = take(octets, 2);
  if (age_ms > longest_age_ms || qos > 2 || size > octets.size()) return std::nullopt;
  message.topic = std::string(as_text(octets.first(size)));
  if (!is_valid_topic_name(message.topic)) return std::nullopt;
  const ByteView payload = octets.subspan(size);
  message.payload.assign(payload.begin(), payload.end());
  message.qos = static_cast<Qos>(qos);
  message.waited = Waited(age_ms);
  return message;
}

}  // namespace slamgw::sessions
