// SPDX-License-Identifier: Apache-2.0
// Values to octets. Never fails: the caller keeps to the ranges in packet.hpp.
#include "adapters/mqttsn_udp/protocol/flags.hpp"
#include "adapters/mqttsn_udp/protocol/packet.hpp"
#include "daemon/core/spare_buffers.hpp"

namespace slamgw::mqttsn {
namespace {

std::uint8_t code_octet(ReturnCode code) { return static_cast<std::uint8_t>(code); }

std::uint8_t qos_bits(WireQos qos) {
  return static_cast<std::uint8_t>(static_cast<unsigned>(qos) << flag_qos_shift);
}

std::uint8_t flags(bool dup, WireQos qos, bool retain, TopicIdType type) {
  return static_cast<std::uint8_t>((dup ? flag_dup : 0U) | qos_bits(qos) |
                                   (retain ? flag_retain : 0U) | static_cast<unsigned>(type));
}

/// Writes what follows MsgType, and says which MsgType it is.
class BodyWriter {
 public:
  explicit BodyWriter(ByteWriter& to) : to_(to) {}

  MsgType operator()(const Advertise& p) {
    to_.write_u8(p.gateway_id).write_u16_be(p.duration_s);
    return MsgType::advertise;
  }
  MsgType operator()(const SearchGw& p) {
    to_.write_u8(p.radius);
    return MsgType::searchgw;
  }
  MsgType operator()(const GwInfo& p) {
    to_.write_u8(p.gateway_id).write(p.gateway_address);
    return MsgType::gwinfo;
  }
  MsgType operator()(const Connect& p) {
    to_.write_u8(static_cast<std::uint8_t>((p.will ? flag_will : 0U) |
                                           (p.clean_session ? flag_clean_session : 0U)));
    to_.write_u8(p.protocol).write_u16_be(p.duration_s).write(p.client_id);
    return MsgType::connect;
  }
  MsgType operator()(const Connack& p) { return code_only(p.code, MsgType::connack); }
  MsgType operator()(const WillTopicReq&) { return MsgType::willtopicreq; }
  MsgType operator()(const WillTopic& p) { return will_topic(p, MsgType::willtopic); }
  MsgType operator()(const WillMsgReq&) { return MsgType::willmsgreq; }
  MsgType operator()(const WillMsg& p) {
    to_.write(p.message);
    return MsgType::willmsg;
  }
  MsgType operator()(const Register& p) {
    to_.write_u16_be(p.topic_id).write_u16_be(p.msg_id).write(p.topic_name);
    return MsgType::register_topic;
  }
  MsgType operator()(const Regack& p) { return topic_ack(p, MsgType::regack); }
  MsgType operator()(const Publish& p) {
    to_.write_u8(flags(p.dup, p.qos, p.retain, p.topic_id_type));
    to_.write_u16_be(p.topic_id).write_u16_be(p.msg_id).write(p.payload);
    return MsgType::publish;
  }
  MsgType operator()(const Puback& p) { return topic_ack(p, MsgType::puback); }
  MsgType operator()(const Pubcomp& p) { return id_only(p.msg_id, MsgType::pubcomp); }
  MsgType operator()(const Pubrec& p) { return id_only(p.msg_id, MsgType::pubrec); }
  MsgType operator()(const Pubrel& p) { return id_only(p.msg_id, MsgType::pubrel); }
  MsgType operator()(const Subscribe& p) {
    to_.write_u8(flags(p.dup, p.qos, false, p.topic_id_type)).write_u16_be(p.msg_id);
    name_or_id(p);
    return MsgType::subscribe;
  }
  MsgType operator()(const Suback& p) {
    to_.write_u8(qos_bits(p.qos)).write_u16_be(p.topic_id).write_u16_be(p.msg_id);
    to_.write_u8(code_octet(p.code));
    return MsgType::suback;
  }
  MsgType operator()(const Unsubscribe& p) {
    to_.write_u8(flags(false, WireQos::zero, false, p.topic_id_type)).write_u16_be(p.msg_id);
    name_or_id(p);
    return MsgType::unsubscribe;
  }
  MsgType operator()(const Unsuback& p) { return id_only(p.msg_id, MsgType::unsuback); }
  MsgType operator()(const Pingreq& p) {
    to_.write(p.client_id);
    return MsgType::pingreq;
  }
  MsgType operator()(const Pingresp&) { return MsgType::pingresp; }
  MsgType operator()(const Disconnect& p) {
    if (p.duration_s) to_.write_u16_be(*p.duration_s);
    return MsgType::disconnect;
  }
  MsgType operator()(const WillTopicUpd& p) { return will_topic(p, MsgType::willtopicupd); }
  MsgType operator()(const WillTopicResp& p) { return code_only(p.code, MsgType::willtopicresp); }
  MsgType operator()(const WillMsgUpd& p) {
    to_.write(p.message);
    return MsgType::willmsgupd;
  }
  MsgType operator()(const WillMsgResp& p) { return code_only(p.code, MsgType::willmsgresp); }

 private:
  MsgType code_only(ReturnCode code, MsgType type) {
    to_.write_u8(code_octet(code));
    return type;
  }
  MsgType id_only(std::uint16_t msg_id, MsgType type) {
    to_.write_u16_be(msg_id);
    return type;
  }
  template <class Ack>
  MsgType topic_ack(const Ack& p, MsgType type) {
    to_.write_u16_be(p.topic_id).write_u16_be(p.msg_id).write_u8(code_octet(p.code));
    return type;
  }
  template <class Topic>
  MsgType will_topic(const Topic& p, MsgType type) {
    if (!p.topic.empty())
      to_.write_u8(flags(false, p.qos, p.retain, TopicIdType::normal)).write(p.topic);
    return type;
  }
  template <class Request>
  void name_or_id(const Request& p) {
    const bool is_name =
        p.topic_id_type == TopicIdType::normal || p.topic_id_type == TopicIdType::reserved;
    if (is_name) {
      to_.write(p.topic_name);
    } else {
      to_.write_u16_be(p.topic_id);
    }
  }

  ByteWriter& to_;
};

}  // namespace

Bytes encode(const Packet& packet) {
  constexpr std::uint8_t later = 0;
  ByteWriter writer(SpareBuffers<Bytes>::take());
  writer.write_u8(later).write_u8(later);
  BodyWriter write_body(writer);
  const MsgType type = std::visit(write_body, packet);
  Bytes message = writer.take();
  message[1] = static_cast<std::uint8_t>(type);
  const std::size_t short_total = message.size();
  if (short_total <= 255) {
    message[0] = static_cast<std::uint8_t>(short_total);
    return message;
  }
  const std::size_t total = short_total + 2;
  message[0] = 0x01;
  message.insert(message.begin() + 1,
                 {static_cast<std::uint8_t>(total >> 8), static_cast<std::uint8_t>(total & 0xff)});
  return message;
}

Bytes encode_encapsulation(std::uint8_t radius, std::string_view node_id, ByteView inner) {
  ByteWriter message;
  message.write_u8(static_cast<std::uint8_t>(3 + node_id.size()));
  message.write_u8(static_cast<std::uint8_t>(MsgType::encapsulated));
  message.write_u8(radius & encapsulation_radius_bits).write(node_id).write(inner);
  return message.take();
}

}  // namespace slamgw::mqttsn
