// SPDX-License-Identifier: Apache-2.0
#include "tests/mqttsn_udp/describe.hpp"

#include <fmt/format.h>

namespace slamgw::mqttsn {
namespace {

std::string_view word(WireQos qos) {
  switch (qos) {
    case WireQos::zero: return "0";
    case WireQos::one: return "1";
    case WireQos::two: return "2";
    case WireQos::minus_one: return "-1";
  }
  return "?";
}

std::string_view word(TopicIdType type) {
  switch (type) {
    case TopicIdType::normal: return "normal";
    case TopicIdType::predefined: return "predefined";
    case TopicIdType::short_name: return "short";
    case TopicIdType::reserved: return "reserved";
  }
  return "?";
}

int number(ReturnCode code) { return static_cast<int>(code); }
int bit(bool flag) { return flag ? 1 : 0; }

std::string payload(const Bytes& bytes) {
  return bytes.size() > 90 ? fmt::format("{} octets", bytes.size()) : to_hex(bytes);
}

template <class Will>
std::string will_topic(std::string_view name, const Will& p) {
  if (p.topic.empty()) return fmt::format("{} none", name);
  return fmt::format("{} qos={} retain={} topic={}", name, word(p.qos), bit(p.retain), p.topic);
}

template <class Request>
std::string name_or_id(const Request& p) {
  const bool is_name =
      p.topic_id_type == TopicIdType::normal || p.topic_id_type == TopicIdType::reserved;
  return is_name ? "topic=" + p.topic_name : fmt::format("id={}", p.topic_id);
}

struct Describe {
  std::string operator()(const Advertise& p) {
    return fmt::format("ADVERTISE gw={} duration={}", p.gateway_id, p.duration_s);
  }
  std::string operator()(const SearchGw& p) { return fmt::format("SEARCHGW radius={}", p.radius); }
  std::string operator()(const GwInfo& p) {
    return fmt::format("GWINFO gw={} address={}", p.gateway_id, to_hex(p.gateway_address));
  }
  std::string operator()(const Connect& p) {
    return fmt::format("CONNECT will={} clean={} protocol={} duration={} client={}", bit(p.will),
                       bit(p.clean_session), p.protocol, p.duration_s, p.client_id);
  }
  std::string operator()(const Connack& p) { return code("CONNACK", p.code); }
  std::string operator()(const WillTopicReq&) { return "WILLTOPICREQ"; }
  std::string operator()(const WillTopic& p) { return will_topic("WILLTOPIC", p); }
  std::string operator()(const WillMsgReq&) { return "WILLMSGREQ"; }
  std::string operator()(const WillMsg& p) { return "WILLMSG message=" + to_hex(p.message); }
  std::string operator()(const Register& p) {
    return fmt::format("REGISTER id={} msg={} topic={}", p.topic_id, p.msg_id, p.topic_name);
  }
  std::string operator()(const Regack& p) { return ack("REGACK", p); }
  std::string operator()(const Publish& p) {
    return fmt::format("PUBLISH dup={} qos={} retain={} {} id={} msg={} data={}", bit(p.dup),
                       word(p.qos), bit(p.retain), word(p.topic_id_type), p.topic_id, p.msg_id,
                       payload(p.payload));
  }
  std::string operator()(const Puback& p) { return ack("PUBACK", p); }
  std::string operator()(const Pubcomp& p) { return msg("PUBCOMP", p.msg_id); }
  std::string operator()(const Pubrec& p) { return msg("PUBREC", p.msg_id); }
  std::string operator()(const Pubrel& p) { return msg("PUBREL", p.msg_id); }
  std::string operator()(const Subscribe& p) {
    return fmt::format("SUBSCRIBE dup={} qos={} {} msg={} {}", bit(p.dup), word(p.qos),
                       word(p.topic_id_type), p.msg_id, name_or_id(p));
  }
  std::string operator()(const Suback& p) {
    return fmt::format("SUBACK qos={} id={} msg={} code={}", word(p.qos), p.topic_id, p.msg_id,
                       number(p.code));
  }
  std::string operator()(const Unsubscribe& p) {
    return fmt::format("UNSUBSCRIBE {} msg={} {}", word(p.topic_id_type), p.msg_id, name_or_id(p));
  }
  std::string operator()(const Unsuback& p) { return msg("UNSUBACK", p.msg_id); }
  std::string operator()(const Pingreq& p) { return "PINGREQ client=" + p.client_id; }
  std::string operator()(const Pingresp&) { return "PINGRESP"; }
  std::string operator()(const Disconnect& p) {
    return p.duration_s ? fmt::format("DISCONNECT duration={}", *p.duration_s) : "DISCONNECT plain";
  }
  std::string operator()(const WillTopicUpd& p) { return will_topic("WILLTOPICUPD", p); }
  std::string operator()(const WillTopicResp& p) { return code("WILLTOPICRESP", p.code); }
  std::string operator()(const WillMsgUpd& p) { return "WILLMSGUPD message=" + to_hex(p.message); }
  std::string operator()(const WillMsgResp& p) { return code("WILLMSGRESP", p.code); }

  static std::string code(std::string_view name, ReturnCode code) {
    return fmt::format("{} code={}", name, number(code));
  }
  static std::string msg(std::string_view name, std::uint16_t msg_id) {
    return fmt::format("{} msg={}", name, msg_id);
  }
  template <class Ack>
  static std::string ack(std::string_view name, const Ack& p) {
    return fmt::format("{} id={} msg={} code={}", name, p.topic_id, p.msg_id, number(p.code));
  }
};

}  // namespace

std::string describe(const Packet& packet) { return std::visit(Describe{}, packet); }

std::string describe_octets(ByteView octets) {
  if (is_encapsulated(octets)) {
    const auto outer = decode_encapsulation(octets);
    const std::string inside = outer ? describe_octets(outer->inner) : "invalid";
    if (inside == "invalid") return inside;
    return fmt::format("fwd({},{}) {}", to_hex(as_bytes(outer->node_id)), outer->radius, inside);
  }
  const auto packet = decode(octets);
  return packet ? describe(*packet) : "invalid";
}

Bytes hex(std::string_view text) {
  std::string digits(text);
  std::erase(digits, ' ');
  return from_hex(digits).value();
}

}  // namespace slamgw::mqttsn
