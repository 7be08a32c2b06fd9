// SPDX-License-Identifier: Apache-2.0
// The fields of each message, written once for reading and writing. Every size rule of MQTT-SN 1.2
// section 5.4 is here and nowhere else. SnGateway decides whether a message is expected.
#include "adapters/mqttsn_udp/protocol/packet.hpp"

#include <array>
#include <utility>

#include "daemon/core/spare_buffers.hpp"

namespace slamgw::mqttsn {
namespace {

/// The types in the order of Packet's alternatives.
constexpr std::array<MsgType, std::variant_size_v<Packet>> types = {
    MsgType::advertise,     MsgType::searchgw,       MsgType::gwinfo,      MsgType::connect,
    MsgType::connack,       MsgType::willtopicreq,   MsgType::willtopic,   MsgType::willmsgreq,
    MsgType::willmsg,       MsgType::register_topic, MsgType::regack,      MsgType::publish,
    MsgType::puback,        MsgType::pubcomp,        MsgType::pubrec,      MsgType::pubrel,
    MsgType::subscribe,     MsgType::suback,         MsgType::unsubscribe, MsgType::unsuback,
    MsgType::pingreq,       MsgType::pingresp,       MsgType::disconnect,  MsgType::willtopicupd,
    MsgType::willtopicresp, MsgType::willmsgupd,     MsgType::willmsgresp};

/// The Flags octet (section 5.3.4): a pointer to each field that the message has.
struct Flags {
  static constexpr unsigned dup_bit = 0x80;
  static constexpr unsigned qos_shift = 5;
  static constexpr unsigned retain_bit = 0x10;
  static constexpr unsigned will_bit = 0x08;
  static constexpr unsigned clean_session_bit = 0x04;
  static constexpr unsigned topic_id_type_bits = 0x03;

  bool* dup = nullptr;
  WireQos* qos = nullptr;
  bool* retain = nullptr;
  bool* will = nullptr;
  bool* clean_session = nullptr;
  TopicIdType* topic_id_type = nullptr;
};

/// Ctrl of an encapsulated message (section 5.5); the other bits are reserved.
constexpr std::uint8_t encapsulation_radius_bits = 0x03;

class FieldReader {
 public:
  explicit FieldReader(ByteReader& in) : in_(in) {}

  template <class... Fields>
  void operator()(Fields&&... fields) {
    (take(fields), ...);
  }
  /// Text of at least one octet, to the end of the message.
  void name(std::string& text) {
    take(text);
    is_malformed_ |= text.empty();
  }
  /// Returns true if octets are left: the optional fields that end with this one are there.
  bool has(const auto&) const { return in_.remaining() > 0; }
  bool is_done() const { return !is_malformed_ && in_.at_end(); }

 private:
  void take(std::uint8_t& octet) { octet = in_.read_u8(); }
  void take(std::uint16_t& number) { number = in_.read_u16_be(); }
  void take(std::optional<std::uint16_t>& number) { number = in_.read_u16_be(); }
  void take(ReturnCode& code) { code = static_cast<ReturnCode>(in_.read_u8()); }
  void take(std::string& text) { text = as_text(in_.read_rest()); }
  void take(Bytes& octets) { octets = SpareBuffers<Bytes>::copy(in_.read_rest()); }
  void take(const Flags& flags) {
    const std::uint8_t octet = in_.read_u8();
    if (flags.dup) *flags.dup = (octet & Flags::dup_bit) != 0;
    if (flags.qos) *flags.qos = static_cast<WireQos>((octet >> Flags::qos_shift) & 0x03);
    if (flags.retain) *flags.retain = (octet & Flags::retain_bit) != 0;
    if (flags.will) *flags.will = (octet & Flags::will_bit) != 0;
    if (flags.clean_session) *flags.clean_session = (octet & Flags::clean_session_bit) != 0;
    if (flags.topic_id_type)
      *flags.topic_id_type = static_cast<TopicIdType>(octet & Flags::topic_id_type_bits);
  }

  ByteReader& in_;
  bool is_malformed_ = false;
};

/// Never fails: the caller keeps to the ranges in packet.hpp.
class FieldWriter {
 public:
  explicit FieldWriter(ByteWriter& to) : to_(to) {}

  template <class... Fields>
  void operator()(const Fields&... fields) {
    (put(fields), ...);
  }
  void name(const std::string& text) { to_.write(text); }
  bool has(const std::string& text) const { return !text.empty(); }
  bool has(const std::optional<std::uint16_t>& number) const { return number.has_value(); }

 private:
  void put(std::uint8_t octet) { to_.write_u8(octet); }
  void put(std::uint16_t number) { to_.write_u16_be(number); }
  void put(const std::optional<std::uint16_t>& number) { to_.write_u16_be(*number); }
  void put(ReturnCode code) { to_.write_u8(static_cast<std::uint8_t>(code)); }
  void put(const std::string& text) { to_.write(text); }
  void put(const Bytes& octets) { to_.write(octets); }
  void put(const Flags& flags) {
    unsigned octet = 0;
    if (flags.dup && *flags.dup) octet |= Flags::dup_bit;
    if (flags.qos) octet |= static_cast<unsigned>(*flags.qos) << Flags::qos_shift;
    if (flags.retain && *flags.retain) octet |= Flags::retain_bit;
    if (flags.will && *flags.will) octet |= Flags::will_bit;
    if (flags.clean_session && *flags.clean_session) octet |= Flags::clean_session_bit;
    if (flags.topic_id_type) octet |= static_cast<unsigned>(*flags.topic_id_type);
    to_.write_u8(static_cast<std::uint8_t>(octet));
  }

  ByteWriter& to_;
};

// pass(): the fields of each message, in their order on the wire, for a reader or a writer.

void pass(auto& io, Advertise& p) { io(p.gateway_id, p.duration_s); }
void pass(auto& io, SearchGw& p) { io(p.radius); }
void pass(auto& io, GwInfo& p) { io(p.gateway_id, p.gateway_address); }
void pass(auto& io, Connect& p) {
  io(Flags{.will = &p.will, .clean_session = &p.clean_session}, p.protocol, p.duration_s,
     p.client_id);
}
/// An empty message deletes the will; flags without a topic are malformed (R4).
void pass_will_topic(auto& io, auto& p) {
  if (!io.has(p.topic)) return;
  io(Flags{.qos = &p.qos, .retain = &p.retain});
  io.name(p.topic);
}
void pass(auto& io, WillTopic& p) { pass_will_topic(io, p); }
void pass(auto& io, WillTopicUpd& p) { pass_will_topic(io, p); }
void pass(auto& io, Register& p) {
  io(p.topic_id, p.msg_id);
  io.name(p.topic_name);
}
void pass(auto& io, Publish& p) {
  io(Flags{.dup = &p.dup, .qos = &p.qos, .retain = &p.retain, .topic_id_type = &p.topic_id_type},
     p.topic_id, p.msg_id, p.payload);
}
/// A name of at least one octet, or exactly one id.
void pass_name_or_id(auto& io, auto& p) {
  switch (p.topic_id_type) {
    case TopicIdType::normal:
    case TopicIdType::reserved: return io.name(p.topic_name);
    case TopicIdType::predefined:
    case TopicIdType::short_name: return io(p.topic_id);
  }
}
void pass(auto& io, Subscribe& p) {
  io(Flags{.dup = &p.dup, .qos = &p.qos, .topic_id_type = &p.topic_id_type}, p.msg_id);
  pass_name_or_id(io, p);
}
void pass(auto& io, Suback& p) { io(Flags{.qos = &p.qos}, p.topic_id, p.msg_id, p.code); }
void pass(auto& io, Unsubscribe& p) {
  io(Flags{.topic_id_type = &p.topic_id_type}, p.msg_id);
  pass_name_or_id(io, p);
}
void pass(auto& io, Pingreq& p) { io(p.client_id); }
void pass(auto& io, Disconnect& p) {
  if (io.has(p.duration_s)) io(p.duration_s);
}
/// All other messages have some of these fields in this order, or none.
void pass(auto& io, auto& p) {
  if constexpr (requires { p.topic_id; }) io(p.topic_id);
  if constexpr (requires { p.msg_id; }) io(p.msg_id);
  if constexpr (requires { p.code; }) io(p.code);
  if constexpr (requires { p.message; }) io(p.message);
}

constexpr std::uint8_t octet_of(MsgType type) { return static_cast<std::uint8_t>(type); }

/// Returns an empty message of this type; nothing for a type that is unknown or reserved.
template <std::size_t index = 0>
std::optional<Packet> make(std::uint8_t type) {
  if constexpr (index < types.size()) {
    if (octet_of(types[index]) == type) return Packet(std::in_place_index<index>);
    return make<index + 1>(type);
  }
  return std::nullopt;
}

/// Reads Length, in either form. Returns the size of the whole message, or 0 if it is cut short.
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
  if (type == octet_of(MsgType::encapsulated)) return DecodeError::bad_encapsulation;
  auto packet = make(type);
  if (!packet) return DecodeError::unknown_type;
  FieldReader reader(in);
  std::visit([&](auto& message) { pass(reader, message); }, *packet);
  if (!reader.is_done()) return DecodeError::malformed;
  return std::move(*packet);
}

Bytes encode(Packet packet) {
  constexpr std::uint8_t later = 0;
  ByteWriter to(SpareBuffers<Bytes>::take());
  to.write_u8(later).write_u8(octet_of(types[packet.index()]));
  FieldWriter writer(to);
  std::visit([&](auto& message) { pass(writer, message); }, packet);
  Bytes message = to.take();
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

Bytes encode_encapsulation(std::uint8_t radius, std::string_view node_id, ByteView inner) {
  ByteWriter message;
  message.write_u8(static_cast<std::uint8_t>(3 + node_id.size()));
  message.write_u8(static_cast<std::uint8_t>(MsgType::encapsulated));
  message.write_u8(radius & encapsulation_radius_bits).write(node_id).write(inner);
  return message.take();
}

}  // namespace slamgw::mqttsn
