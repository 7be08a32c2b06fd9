// SPDX-License-Identifier: Apache-2.0
#include "simulation/thread/packet.hpp"

namespace slamgw::sim::sn {
namespace {

/// Puts Length and MsgType in front: one octet of Length up to 255 octets in all, else three.
Bytes finish(Type type, const Bytes& variable) {
  Bytes out;
  const std::size_t total = variable.size() + 2;
  if (total <= 255) {
    put_u8(out, static_cast<std::uint8_t>(total));
  } else {
    put_u8(out, 0x01);
    put_u16_be(out, static_cast<std::uint16_t>(total + 2));
  }
  put_u8(out, static_cast<std::uint8_t>(type));
  put(out, variable);
  return out;
}

std::uint8_t qos_flags(unsigned qos) { return static_cast<std::uint8_t>(qos << 5 & mask_qos); }

/// TopicId, MsgId, ReturnCode: the body of REGACK and PUBACK.
Bytes ids_and_code(std::uint16_t topic_id, std::uint16_t msg_id, std::uint8_t return_code) {
  Bytes out;
  put_u16_be(out, topic_id);
  put_u16_be(out, msg_id);
  put_u8(out, return_code);
  return out;
}

/// Returns the part after Length, or nothing when Length does not match the datagram.
std::optional<ByteView> strip_length(ByteView datagram) {
  if (datagram.size() >= 2 && datagram[0] >= 2 && datagram[0] == datagram.size()) {
    return datagram.subspan(1);
  }
  if (datagram.size() >= 4 && datagram[0] == 1 && get_u16_be(datagram, 1) == datagram.size()) {
    return datagram.subspan(3);
  }
  return std::nullopt;
}

}  // namespace

Bytes searchgw(std::uint8_t radius) { return finish(Type::searchgw, {radius}); }

Bytes connect(std::string_view client_id, std::uint16_t keep_alive_s, std::uint8_t flags) {
  Bytes body{flags, 0x01};
  put_u16_be(body, keep_alive_s);
  put(body, client_id);
  return finish(Type::connect, body);
}

Bytes willtopic(std::string_view topic, std::uint8_t flags) {
  Bytes body{flags};
  put(body, topic);
  return finish(Type::willtopic, body);
}

Bytes willmsg(std::string_view message) {
  return finish(Type::willmsg, Bytes(message.begin(), message.end()));
}

Bytes willtopicupd(std::string_view topic, unsigned qos) {
  Bytes body{qos_flags(qos)};
  put(body, topic);
  return finish(Type::willtopicupd, body);
}

Bytes willmsgupd(std::string_view message) {
  return finish(Type::willmsgupd, Bytes(message.begin(), message.end()));
}

Bytes register_topic(std::uint16_t msg_id, std::string_view topic) {
  Bytes body{0x00, 0x00};
  put_u16_be(body, msg_id);
  put(body, topic);
  return finish(Type::register_topic, body);
}

Bytes regack(std::uint16_t topic_id, std::uint16_t msg_id, std::uint8_t return_code) {
  return finish(Type::regack, ids_and_code(topic_id, msg_id, return_code));
}

Bytes publish(unsigned qos, std::uint16_t topic_id, std::uint16_t msg_id, ByteView payload) {
  Bytes body{qos_flags(qos)};
  put_u16_be(body, topic_id);
  put_u16_be(body, msg_id);
  put(body, payload);
  return finish(Type::publish, body);
}

Bytes publish_unconnected(std::uint16_t predefined_id, ByteView payload) {
  Bytes body{mask_qos | topic_id_predefined};
  put_u16_be(body, predefined_id);
  put_u16_be(body, 0);
  put(body, payload);
  return finish(Type::publish, body);
}

Bytes puback(std::uint16_t topic_id, std::uint16_t msg_id, std::uint8_t return_code) {
  return finish(Type::puback, ids_and_code(topic_id, msg_id, return_code));
}

Bytes qos2_step(Type type, std::uint16_t msg_id) {
  Bytes body;
  put_u16_be(body, msg_id);
  return finish(type, body);
}

Bytes subscribe(unsigned qos, std::uint16_t msg_id, std::string_view topic) {
  Bytes body{qos_flags(qos)};
  put_u16_be(body, msg_id);
  put(body, topic);
  return finish(Type::subscribe, body);
}

Bytes pingreq(std::string_view client_id) {
  return finish(Type::pingreq, Bytes(client_id.begin(), client_id.end()));
}

Bytes disconnect() { return finish(Type::disconnect, {}); }

Bytes disconnect(std::uint16_t duration_s) {
  Bytes body;
  put_u16_be(body, duration_s);
  return finish(Type::disconnect, body);
}

std::optional<Packet> decode(ByteView datagram) {
  const std::optional<ByteView> message = strip_length(datagram);
  if (!message) return std::nullopt;
  const ByteView body = message->subspan(1);
  Packet packet;
  packet.type = static_cast<Type>((*message)[0]);
  switch (packet.type) {
    case Type::gwinfo:
      if (body.empty()) return std::nullopt;
      packet.gateway_id = body[0];
      return packet;
    case Type::connack:
    case Type::willtopicresp:
    case Type::willmsgresp:
      if (body.size() != 1) return std::nullopt;
      packet.return_code = body[0];
      return packet;
    case Type::register_topic:
      if (body.size() < 5) return std::nullopt;
      packet.topic_id = get_u16_be(body, 0);
      packet.msg_id = get_u16_be(body, 2);
      packet.payload = body.subspan(4);
      return packet;
    case Type::regack:
    case Type::puback:
      if (body.size() != 5) return std::nullopt;
      packet.topic_id = get_u16_be(body, 0);
      packet.msg_id = get_u16_be(body, 2);
      packet.return_code = body[4];
      return packet;
    case Type::publish:
      if (body.size() < 5) return std::nullopt;
      packet.flags = body[0];
      packet.topic_id = get_u16_be(body, 1);
      packet.msg_id = get_u16_be(body, 3);
      packet.payload = body.subspan(5);
      return packet;
    case Type::pubcomp:
    case Type::pubrec:
    case Type::pubrel:
      if (body.size() != 2) return std::nullopt;
      packet.msg_id = get_u16_be(body, 0);
      return packet;
    case Type::suback:
      if (body.size() != 6) return std::nullopt;
      packet.flags = body[0];
      packet.topic_id = get_u16_be(body, 1);
      packet.msg_id = get_u16_be(body, 3);
      packet.return_code = body[5];
      return packet;
    case Type::willtopicreq:
    case Type::willmsgreq:
    case Type::pingresp:
    case Type::disconnect:
      if (!body.empty()) return std::nullopt;
      return packet;
    case Type::pingreq: return packet;
    case Type::advertise:
    case Type::searchgw:
    case Type::connect:
    case Type::willtopic:
    case Type::willmsg:
    case Type::subscribe:
    case Type::willtopicupd:
    case Type::willmsgupd: return std::nullopt;
  }
  return std::nullopt;
}

}  // namespace slamgw::sim::sn
