// SPDX-License-Identifier: Apache-2.0
// MQTT-SN 1.2 as a client writes and reads it (sections 5.2-5.4). Integers are big-endian. Not a
// complete codec: only what a robot sends and what a gateway may send to it.
#pragma once

#include <cstdint>
#include <optional>
#include <string_view>

#include "simulation/bytes.hpp"

namespace slamgw::sim::sn {

enum class Type : std::uint8_t {
  advertise = 0x00,
  searchgw = 0x01,
  gwinfo = 0x02,
  connect = 0x04,
  connack = 0x05,
  willtopicreq = 0x06,
  willtopic = 0x07,
  willmsgreq = 0x08,
  willmsg = 0x09,
  register_topic = 0x0a,
  regack = 0x0b,
  publish = 0x0c,
  puback = 0x0d,
  pubcomp = 0x0e,
  pubrec = 0x0f,
  pubrel = 0x10,
  subscribe = 0x12,
  suback = 0x13,
  pingreq = 0x16,
  pingresp = 0x17,
  disconnect = 0x18,
  willtopicupd = 0x1a,
  willtopicresp = 0x1b,
  willmsgupd = 0x1c,
  willmsgresp = 0x1d,
};

// Flags octet
constexpr std::uint8_t flag_dup = 0x80;
constexpr std::uint8_t flag_will = 0x08;
constexpr std::uint8_t flag_clean_session = 0x04;
constexpr std::uint8_t mask_qos = 0x60;
constexpr std::uint8_t topic_id_predefined = 0x01;  // of the two topic id type bits

/// Return codes; anything above is a rejection too.
constexpr std::uint8_t accepted = 0x00;
constexpr std::uint8_t congestion = 0x01;
constexpr std::uint8_t invalid_topic_id = 0x02;

Bytes searchgw(std::uint8_t radius);
Bytes connect(std::string_view client_id, std::uint16_t keep_alive_s, std::uint8_t flags);
Bytes willtopic(std::string_view topic, std::uint8_t flags);
Bytes willmsg(std::string_view message);
Bytes willtopicupd(std::string_view topic, unsigned qos);
Bytes willmsgupd(std::string_view message);
Bytes register_topic(std::uint16_t msg_id, std::string_view topic);
Bytes regack(std::uint16_t topic_id, std::uint16_t msg_id, std::uint8_t return_code);
/// Normal topic id; `qos` 0..2; `msg_id` is 0 for QoS 0 (section 5.4.12).
Bytes publish(unsigned qos, std::uint16_t topic_id, std::uint16_t msg_id, ByteView payload);
/// QoS -1 on a pre-defined topic id (section 6.8): no session, no answer.
Bytes publish_unconnected(std::uint16_t predefined_id, ByteView payload);
Bytes puback(std::uint16_t topic_id, std::uint16_t msg_id, std::uint8_t return_code);
/// PUBREC, PUBREL or PUBCOMP.
Bytes qos2_step(Type type, std::uint16_t msg_id);
Bytes subscribe(unsigned qos, std::uint16_t msg_id, std::string_view topic);
Bytes pingreq(std::string_view client_id);
Bytes disconnect();
/// Asks for sleep; `duration_s` is above 0 (section 6.14).
Bytes disconnect(std::uint16_t duration_s);

/// A message from the gateway. Fields that its type does not have stay 0 or empty.
struct Packet {
  Type type = Type::advertise;
  std::uint8_t flags = 0;
  std::uint8_t gateway_id = 0;
  std::uint16_t topic_id = 0;
  std::uint16_t msg_id = 0;
  std::uint8_t return_code = 0;
  ByteView payload;  ///< PUBLISH: data; REGISTER: topic name. A view into the datagram

  unsigned qos() const { return (flags & mask_qos) >> 5; }
};

/// Returns nothing for messages that a gateway never sends: wrong length, unknown or client-only
/// type.
std::optional<Packet> decode(ByteView datagram);

}  // namespace slamgw::sim::sn
