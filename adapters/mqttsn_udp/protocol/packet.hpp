// SPDX-License-Identifier: Apache-2.0
// MQTT-SN 1.2 messages as values, and the codec between them and octets. One value is one message;
// what a message means is decided elsewhere. Called by SnGateway and by tests. All integers on the
// wire are big-endian.
//
//   Length 1, or 0x01 and 2 octets | MsgType 1 | fields of the type (section 5.4)
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <variant>

#include "daemon/core/bytes.hpp"
#include "daemon/core/result.hpp"

namespace slamgw::mqttsn {

enum class MsgType : std::uint8_t {
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
  unsubscribe = 0x14,
  unsuback = 0x15,
  pingreq = 0x16,
  pingresp = 0x17,
  disconnect = 0x18,
  willtopicupd = 0x1a,
  willtopicresp = 0x1b,
  willmsgupd = 0x1c,
  willmsgresp = 0x1d,
  encapsulated = 0xfe,
};

/// Values 4-255 are reserved: they arrive as their number and count as a rejection without retry.
enum class ReturnCode : std::uint8_t {
  accepted = 0,
  congestion = 1,
  invalid_topic_id = 2,
  not_supported = 3,
};

/// `normal` in SUBSCRIBE and UNSUBSCRIBE: a topic name follows instead of an id.
enum class TopicIdType : std::uint8_t { normal = 0, predefined = 1, short_name = 2, reserved = 3 };

/// The two QoS bits. `minus_one` is legal only in a client's PUBLISH.
enum class WireQos : std::uint8_t { zero = 0, one = 1, two = 2, minus_one = 3 };

constexpr std::uint8_t protocol_id = 0x01;

struct Advertise {
  std::uint8_t gateway_id = 0;
  std::uint16_t duration_s = 0;  ///< until the next ADVERTISE
};
struct SearchGw {
  std::uint8_t radius = 0;  ///< 0: the whole network
};
struct GwInfo {
  std::uint8_t gateway_id = 0;
  Bytes gateway_address;  ///< only when a client answers; the first octet is its length
};
struct Connect {
  bool will = false;
  bool clean_session = false;
  std::uint8_t protocol = protocol_id;
  std::uint16_t duration_s = 0;  ///< keep-alive
  std::string client_id;         ///< empty: refused (R31)
};
struct Connack {
  ReturnCode code = ReturnCode::accepted;
};
struct WillTopicReq {};
struct WillTopic {
  WireQos qos = WireQos::zero;
  bool retain = false;
  std::string topic;  ///< empty: delete the will; the message then has no flags either
};
struct WillMsgReq {};
struct WillMsg {
  Bytes message;
};
struct Register {
  std::uint16_t topic_id = 0;  ///< 0 from a client
  std::uint16_t msg_id = 0;
  std::string topic_name;
};
struct Regack {
  std::uint16_t topic_id = 0;
  std::uint16_t msg_id = 0;
  ReturnCode code = ReturnCode::accepted;
};
struct Publish {
  bool dup = false;
  WireQos qos = WireQos::zero;
  bool retain = false;
  TopicIdType topic_id_type = TopicIdType::normal;
  std::uint16_t topic_id = 0;  ///< short names: the two octets, the first one high
  std::uint16_t msg_id = 0;    ///< 0 for QoS 0 and -1
  Bytes payload;
};
struct Puback {
  std::uint16_t topic_id = 0;
  std::uint16_t msg_id = 0;
  ReturnCode code = ReturnCode::accepted;
};
struct Pubcomp {
  std::uint16_t msg_id = 0;
};
struct Pubrec {
  std::uint16_t msg_id = 0;
};
struct Pubrel {
  std::uint16_t msg_id = 0;
};
struct Subscribe {
  bool dup = false;
  WireQos qos = WireQos::zero;
  TopicIdType topic_id_type = TopicIdType::normal;
  std::uint16_t msg_id = 0;
  std::string topic_name;      ///< for `normal`, and the octets that came with `reserved`
  std::uint16_t topic_id = 0;  ///< for `predefined` and `short_name`
};
struct Suback {
  WireQos qos = WireQos::zero;
  std::uint16_t topic_id = 0;
  std::uint16_t msg_id = 0;
  ReturnCode code = ReturnCode::accepted;
};
struct Unsubscribe {
  TopicIdType topic_id_type = TopicIdType::normal;
  std::uint16_t msg_id = 0;
  std::string topic_name;
  std::uint16_t topic_id = 0;
};
struct Unsuback {
  std::uint16_t msg_id = 0;
};
struct Pingreq {
  std::string client_id;  ///< empty: a plain PINGREQ
};
struct Pingresp {};
struct Disconnect {
  std::optional<std::uint16_t> duration_s;  ///< a client's request to sleep
};
struct WillTopicUpd {
  WireQos qos = WireQos::zero;
  bool retain = false;
  std::string topic;  ///< empty: delete the will
};
struct WillTopicResp {
  ReturnCode code = ReturnCode::accepted;
};
struct WillMsgUpd {
  Bytes message;
};
struct WillMsgResp {
  ReturnCode code = ReturnCode::accepted;
};

using Packet = std::variant<Advertise, SearchGw, GwInfo, Connect, Connack, WillTopicReq, WillTopic,
                            WillMsgReq, WillMsg, Register, Regack, Publish, Puback, Pubcomp, Pubrec,
                            Pubrel, Subscribe, Suback, Unsubscribe, Unsuback, Pingreq, Pingresp,
                            Disconnect, WillTopicUpd, WillTopicResp, WillMsgUpd, WillMsgResp>;

enum class DecodeError : std::uint8_t {
  too_short,         ///< no room for Length and MsgType, or Length is 0
  length_mismatch,   ///< Length is not the size of the datagram (R3)
  unknown_type,      ///< a reserved or unknown MsgType (R5)
  malformed,         ///< a size that this type cannot have (R4)
  bad_encapsulation  ///< no node id, no inner message, or one inside another (R142)
};

/// Decodes one message that fills `datagram` exactly. An encapsulated message gives
/// `bad_encapsulation`: call `decode_encapsulation` first.
Result<Packet, DecodeError> decode(ByteView datagram);

/// Encodes with the 1-octet Length up to 255 octets in total, with the 3-octet Length above (R2).
/// Flag bits without a meaning for the type are 0.
Bytes encode(Packet packet);

/// A forwarder's header (section 5.5): Length covers this header only.
struct Encapsulation {
  std::uint8_t radius = 0;  ///< 0-3
  std::string node_id;      ///< 1-252 octets, binary
  ByteView inner;           ///< the message inside, a view into the datagram
};
bool is_encapsulated(ByteView datagram);
Result<Encapsulation, DecodeError> decode_encapsulation(ByteView datagram);
Bytes encode_encapsulation(std::uint8_t radius, std::string_view node_id, ByteView inner);

}  // namespace slamgw::mqttsn
