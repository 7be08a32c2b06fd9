// SPDX-License-Identifier: Apache-2.0
// Octets to values. Every size rule of MQTT-SN 1.2 section 5.4 is here and nowhere else; whether a
// message is welcome is for SnGateway to say.
#include "adapters/mqttsn_udp/protocol/flags.hpp"
#include "adapters/mqttsn_udp/protocol/packet.hpp"
#include "daemon/core/spare_buffers.hpp"

namespace slamgw::mqttsn {
namespace {

using Decoded = std::optional<Packet>;  // nothing: malformed

struct Flags {
  explicit Flags(std::uint8_t octet)
      : dup((octet & flag_dup) != 0),
        qos(static_cast<WireQos>((octet >> flag_qos_shift) & 0x03)),
        retain((octet & flag_retain) != 0),
        will((octet & flag_will) != 0),
        clean_session((octet & flag_clean_session) != 0),
        topic_id_type(static_cast<TopicIdType>(octet & flag_topic_id_type_bits)) {}

  bool dup;
  WireQos qos;
  bool retain;
  bool will;
  bool clean_session;
  TopicIdType topic_id_type;
};

std::string read_text(ByteReader& in) { return std::string(as_text(in.read_rest())); }

Bytes read_octets(ByteReader& in) { return SpareBuffers<Bytes>::copy(in.read_rest()); }

ReturnCode read_code(ByteReader& in) { return static_cast<ReturnCode>(in.read_u8()); }

template <class T>
Decoded finish(const ByteReader& in, T packet) {
  if (!in.at_end()) return std::nullopt;
  return packet;
}

template <class T>
Decoded decode_empty(ByteReader& in) {
  return finish(in, T{});
}

template <class T>
Decoded decode_code(ByteReader& in) {
  const ReturnCode code = read_code(in);
  return finish(in, T{code});
}

template <class T>
Decoded decode_msg_id(ByteReader& in) {
  const std::uint16_t msg_id = in.read_u16_be();
  return finish(in, T{msg_id});
}

template <class T>
Decoded decode_topic_ack(ByteReader& in) {
  T ack;
  ack.topic_id = in.read_u16_be();
  ack.msg_id = in.read_u16_be();
  ack.code = read_code(in);
  return finish(in, ack);
}

template <class T>
Decoded decode_message(ByteReader& in) {
  return T{read_octets(in)};
}

/// Nothing at all deletes the will; flags without a topic are malformed (R4).
template <class T>
Decoded decode_will_topic(ByteReader& in) {
  if (in.remaining() == 0) return T{};
  const Flags flags(in.read_u8());
  if (in.remaining() == 0) return std::nullopt;
  return T{flags.qos, flags.retain, read_text(in)};
}

Decoded decode_advertise(ByteReader& in) {
  Advertise p;
  p.gateway_id = in.read_u8();
  p.duration_s = in.read_u16_be();
  return finish(in, p);
}

Decoded decode_searchgw(ByteReader& in) {
  const std::uint8_t radius = in.read_u8();
  return finish(in, SearchGw{radius});
}

Decoded decode_gwinfo(ByteReader& in) {
  const std::uint8_t gateway_id = in.read_u8();
  return finish(in, GwInfo{gateway_id, read_octets(in)});
}

Decoded decode_connect(ByteReader& in) {
  const Flags flags(in.read_u8());
  Connect p;
  p.will = flags.will;
  p.clean_session = flags.clean_session;
  p.protocol = in.read_u8();
  p.duration_s = in.read_u16_be();
  p.client_id = read_text(in);
  return finish(in, std::move(p));
}

Decoded decode_register(ByteReader& in) {
  Register p;
  p.topic_id = in.read_u16_be();
  p.msg_id = in.read_u16_be();
  p.topic_name = read_text(in);
  if (p.topic_name.empty()) return std::nullopt;
  return finish(in, std::move(p));
}

Decoded decode_publish(ByteReader& in) {
  const Flags flags(in.read_u8());
  Publish p;
  p.dup = flags.dup;
  p.qos = flags.qos;
  p.retain = flags.retain;
  p.topic_id_type = flags.topic_id_type;
  p.topic_id = in.read_u16_be();
  p.msg_id = in.read_u16_be();
  p.payload = read_octets(in);
  return finish(in, std::move(p));
}

/// SUBSCRIBE and UNSUBSCRIBE: a name of at least one octet, or exactly one id.
template <class T>
bool read_name_or_id(ByteReader& in, T& p) {
  switch (p.topic_id_type) {
    case TopicIdType::normal:
    case TopicIdType::reserved: p.topic_name = read_text(in); return !p.topic_name.empty();
    case TopicIdType::predefined:
    case TopicIdType::short_name: p.topic_id = in.read_u16_be(); return true;
  }
  return false;
}

Decoded decode_subscribe(ByteReader& in) {
  const Flags flags(in.read_u8());
  Subscribe p;
  p.dup = flags.dup;
  p.qos = flags.qos;
  p.topic_id_type = flags.topic_id_type;
  p.msg_id = in.read_u16_be();
  if (!read_name_or_id(in, p)) return std::nullopt;
  return finish(in, std::move(p));
}

Decoded decode_suback(ByteReader& in) {
  Suback p;
  p.qos = Flags(in.read_u8()).qos;
  p.topic_id = in.read_u16_be();
  p.msg_id = in.read_u16_be();
  p.code = read_code(in);
  return finish(in, p);
}

Decoded decode_unsubscribe(ByteReader& in) {
  Unsubscribe p;
  p.topic_id_type = Flags(in.read_u8()).topic_id_type;
  p.msg_id = in.read_u16_be();
  if (!read_name_or_id(in, p)) return std::nullopt;
  return finish(in, std::move(p));
}

Decoded decode_disconnect(ByteReader& in) {
  if (in.remaining() == 0) return Disconnect{};
  const std::uint16_t duration_s = in.read_u16_be();
  return finish(in, Disconnect{duration_s});
}

Decoded decode_body(MsgType type, ByteReader& in) {
  switch (type) {
    case MsgType::advertise: return decode_advertise(in);
    case MsgType::searchgw: return decode_searchgw(in);
    case MsgType::gwinfo: return decode_gwinfo(in);
    case MsgType::connect: return decode_connect(in);
    case MsgType::connack: return decode_code<Connack>(in);
    case MsgType::willtopicreq: return decode_empty<WillTopicReq>(in);
    case MsgType::willtopic: return decode_will_topic<WillTopic>(in);
    case MsgType::willmsgreq: return decode_empty<WillMsgReq>(in);
    case MsgType::willmsg: return decode_message<WillMsg>(in);
    case MsgType::register_topic: return decode_register(in);
    case MsgType::regack: return decode_topic_ack<Regack>(in);
    case MsgType::publish: return decode_publish(in);
    case MsgType::puback: return decode_topic_ack<Puback>(in);
    case MsgType::pubcomp: return decode_msg_id<Pubcomp>(in);
    case MsgType::pubrec: return decode_msg_id<Pubrec>(in);
    case MsgType::pubrel: return decode_msg_id<Pubrel>(in);
    case MsgType::subscribe: return decode_subscribe(in);
    case MsgType::suback: return decode_suback(in);
    case MsgType::unsubscribe: return decode_unsubscribe(in);
    case MsgType::unsuback: return decode_msg_id<Unsuback>(in);
    case MsgType::pingreq: return Pingreq{read_text(in)};
    case MsgType::pingresp: return decode_empty<Pingresp>(in);
    case MsgType::disconnect: return decode_disconnect(in);
    case MsgType::willtopicupd: return decode_will_topic<WillTopicUpd>(in);
    case MsgType::willtopicresp: return decode_code<WillTopicResp>(in);
    case MsgType::willmsgupd: return decode_message<WillMsgUpd>(in);
    case MsgType::willmsgresp: return decode_code<WillMsgResp>(in);
    case MsgType::encapsulated: break;  // refused before
  }
  return std::nullopt;
}

bool is_known(std::uint8_t type) {
  return type <= 0x1d && type != 0x03 && type != 0x11 && type != 0x19;
}

/// Reads Length, in either form; the size of the whole message, or 0 when it is cut short.
std::size_t read_length(ByteReader& in) {
  const std::uint8_t first = in.read_u8();
  return first == 0x01 ? in.read_u16_be() : first;
}

}  // namespace

Result<Packet, DecodeError> decode(ByteView datagram) {
  ByteReader in(datagram);
  const std::size_t length = read_length(in);
  const std::uint8_t type = in.read_u8();
  if (!in.ok() || length == 0) return DecodeError::too_short;
  if (length != datagram.size()) return DecodeError::length_mismatch;
  if (type == static_cast<std::uint8_t>(MsgType::encapsulated))
    return DecodeError::bad_encapsulation;
  if (!is_known(type)) return DecodeError::unknown_type;
  Decoded packet = decode_body(static_cast<MsgType>(type), in);
  if (!packet) return DecodeError::malformed;
  return std::move(*packet);
}

bool is_encapsulated(ByteView datagram) {
  ByteReader in(datagram);
  read_length(in);
  return in.read_u8() == static_cast<std::uint8_t>(MsgType::encapsulated);
}

Result<Encapsulation, DecodeError> decode_encapsulation(ByteView datagram) {
  ByteReader in(datagram);
  const std::size_t length = read_length(in);
  in.read_u8();  // MsgType
  const std::uint8_t control = in.read_u8();
  const std::size_t header = datagram.size() - in.remaining();
  if (!in.ok() || length <= header || length - header > 252) return DecodeError::bad_encapsulation;
  Encapsulation result;
  result.radius = control & encapsulation_radius_bits;
  result.node_id = as_text(in.read(length - header));
  result.inner = in.read_rest();
  if (!in.ok() || result.inner.empty() || is_encapsulated(result.inner))
    return DecodeError::bad_encapsulation;
  return result;
}

}  // namespace slamgw::mqttsn
