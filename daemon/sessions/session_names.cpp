// SPDX-License-Identifier: Apache-2.0
#include "daemon/sessions/session_names.hpp"

#include <algorithm>

namespace slamgw::sessions {

SessionNames::SessionNames(const TopicScheme& scheme)
    : client_id_root_(scheme.prefix() + "-robot-"),
      note_root_(scheme.prefix() + "/fleet/robots/"),
      command_root_(scheme.command_root()) {
  std::ranges::replace(client_id_root_, '/', '-');
}

std::string SessionNames::client_id(std::string_view robot) const {
  return client_id_root_ + std::string(robot);
}

std::string SessionNames::note_topic(std::string_view robot) const {
  return note_root_ + std::string(robot);
}

std::string SessionNames::mailbox_topic(std::string_view robot) const {
  return note_topic(robot) + "/waiting";
}

std::string SessionNames::command_filter(std::string_view robot) const {
  return command_root_ + std::string(robot) + "/#";
}

namespace {

constexpr std::uint32_t longest_age_ms = 3'600'000;

}  // namespace

Bytes encode_waiting(const WaitingMessage& waiting) {
  const BrokerMessage& message = waiting.message;
  const std::uint32_t age_ms = std::min(message.waited.count(), longest_age_ms);
  ByteWriter to;
  to.write_u16_be(static_cast<std::uint16_t>(age_ms >> 16U));
  to.write_u16_be(static_cast<std::uint16_t>(age_ms & 0xffffU));
  to.write_u8(static_cast<std::uint8_t>(message.qos));
  to.write_u16_be(static_cast<std::uint16_t>(message.topic.size()));
  to.write(message.topic).write(message.payload);
  return to.take();
}

std::optional<BrokerMessage> decode_waiting(ByteView octets) {
  ByteReader in(octets);
  const std::uint32_t high = in.read_u16_be();
  const std::uint32_t age_ms = high << 16U | in.read_u16_be();
  const std::uint8_t qos = in.read_u8();
  BrokerMessage message;
  message.topic = as_text(in.read(in.read_u16_be()));
  const ByteView payload = in.read_rest();
  const bool is_whole = in.ok() && age_ms <= longest_age_ms && qos <= 2;
  if (!is_whole || !is_valid_topic_name(message.topic)) return std::nullopt;
  message.payload.assign(payload.begin(), payload.end());
  message.qos = static_cast<Qos>(qos);
  message.waited = Waited(age_ms);
  return message;
}

}  // namespace slamgw::sessions
