// SPDX-License-Identifier: Apache-2.0
// A session's snapshot as octets, and back.
#include <nlohmann/json.hpp>

#include <algorithm>
#include <concepts>

#include "adapters/mqttsn_udp/clients/session_snapshot.hpp"

namespace slamgw::mqttsn {

namespace {

using Json = nlohmann::json;

constexpr unsigned version = 1;

using std::chrono::milliseconds;

/// Checks depth and lengths of CBOR without recursion. The octets may come from another gateway by
/// way of the broker, and the library parses each level on the stack. The library finds all other
/// errors.
class CborBounds {
 public:
  explicit CborBounds(ByteView content) : left_(content) {}

  /// Returns true if the octets are at most `max_depth` deep, have no string in pieces and no tag,
  /// and each length is within the octets.
  bool hold() {
    do {
      if (!take_item()) return false;
      while (!open_.empty() && open_.back() == 0) open_.pop_back();
    } while (!open_.empty());
    return left_.empty();
  }

 private:
  static constexpr std::size_t max_depth = 8;  // a session needs 3
  static constexpr std::uint64_t until_break = UINT64_MAX;
  enum Major : unsigned { unsigned_type, negative, octets, text, array, map, tag, simple };

  /// Takes one item (RFC 8949 section 3): three bits of major type, five that locate the argument.
  bool take_item() {
    constexpr unsigned indefinite = 31;
    if (left_.empty()) return false;
    const unsigned major = left_[0] >> 5U;
    const unsigned code = left_[0] & 31U;
    left_ = left_.subspan(1);
    if (major == simple && code == indefinite) return take_break();
    if (!open_.empty() && open_.back() != until_break) --open_.back();
    if (code == indefinite) return (major == array || major == map) && open(until_break);
    const auto argument = take_argument(code);
    if (!argument) return false;
    switch (major) {
      case octets:
      case text:
        if (*argument > left_.size()) return false;
        left_ = left_.subspan(static_cast<std::size_t>(*argument));
        return true;
      case array: return *argument <= left_.size() && open(*argument);
      case map: return *argument <= left_.size() / 2 && open(*argument * 2);
      default: return major != tag;
    }
  }

  bool take_break() {
    if (open_.empty() || open_.back() != until_break) return false;
    open_.pop_back();
    return true;
  }

  bool open(std::uint64_t items) {
    open_.push_back(items);
    return open_.size() <= max_depth;
  }

  std::optional<std::uint64_t> take_argument(unsigned code) {
    constexpr unsigned in_head = 24;
    constexpr unsigned longest = 27;  // 8 octets
    if (code < in_head) return code;
    const std::size_t size = std::size_t{1} << (code - in_head);
    if (code > longest || size > left_.size()) return std::nullopt;
    std::uint64_t argument = 0;
    for (const std::uint8_t octet : left_.first(size)) argument = argument << 8U | octet;
    left_ = left_.subspan(size);
    return argument;
  }

  ByteView left_;
  std::vector<std::uint64_t> open_;  // for each level the items that are still to come
};

/// Reads a time of the monotonic clock; a time that the type can't hold becomes `latest_ms`.
TimePoint clock_time(const Json& json) {
  constexpr std::uint64_t latest_ms = 1'000'000'000'000;  // 31 years after the host's start
  return TimePoint(milliseconds(std::min(json.get<std::uint64_t>(), latest_ms)));
}

Bytes octets(const Json& json) { return json.get_binary(); }

template <class Enum>
Enum checked(const Json& json, Enum last) {
  const auto value = json.get<unsigned>();
  if (value > static_cast<unsigned>(last)) throw Json::other_error::create(501, "range", nullptr);
  return static_cast<Enum>(value);
}

IpAddress address(const Json& json) {
  const Bytes read = octets(json);
  IpAddress out{};
  if (read.size() != out.size()) throw Json::other_error::create(501, "address", nullptr);
  std::copy(read.begin(), read.end(), out.begin());
  return out;
}

Peer to_peer(const Json& json) {
  const Bytes node = octets(json.at("node"));
  return {{address(json.at("address")), json.at("port"), json.at("scope")},
          std::string(node.begin(), node.end()),
          json.value("identity", std::string())};
}

Will to_will(const Json& json) {
  return {json.at("topic"), octets(json.at("message")), checked(json.at("qos"), Qos::exactly_once),
          json.at("retain")};
}

SubscriptionSnapshot to_subscription(const Json& json) {
  return {json.at(0), checked(json.at(1), Qos::exactly_once),
          checked(json.at(2), TopicIdType::short_name), json.at(3)};
}

MessageSnapshot to_message(const Json& json) {
  MessageSnapshot m;
  m.message = {json.at("topic"), octets(json.at("payload")),
               checked(json.at("sent_qos"), Qos::exactly_once), json.at("retain")};
  m.qos = checked(json.at("qos"), Qos::exactly_once);
  m.topic_id_type = checked(json.at("type"), TopicIdType::short_name);
  m.predefined_id = json.at("predefined");
  m.msg_id = json.at("msg_id");
  if (json.contains("command_ms"))
    m.command_age = std::chrono::milliseconds(json.at("command_ms").get<std::uint32_t>());
  return m;
}

TopicTable::Topic to_topic(const Json& json) {
  return {json.at(0), json.at(3), json.at(1), json.at(2)};
}

SessionSnapshot to_session(const Json& json) {
  SessionSnapshot out;
  out.client_id = json.at("client_id");
  out.robot = json.at("robot");
  out.state = checked(json.at("state"), ClientState::lost);
  if (json.contains("peer")) out.peer = to_peer(json.at("peer"));
  out.local = {address(json.at("local")), json.at("interface"), json.at("socket")};
  out.is_clean = json.at("clean");
  out.keep_alive = std::chrono::seconds(json.at("keep_alive_s").get<std::uint32_t>());
  out.sleep_duration = std::chrono::seconds(json.at("sleep_s").get<std::uint32_t>());
  if (json.contains("will")) out.will = to_will(json.at("will"));
  for (const Json& topic : json.at("topics")) out.topics.push_back(to_topic(topic));
  for (const Json& s : json.at("subscriptions")) out.subscriptions.push_back(to_subscription(s));
  for (const Json& message : json.at("messages")) out.messages.push_back(to_message(message));
  out.released = json.at("released").get<decltype(out.released)>();
  out.abandoned = json.value("abandoned", out.abandoned);
  for (const Json& inbound : json.at("inbound_qos2"))
    out.inbound_qos2.emplace_back(inbound.at(0), inbound.at(1));
  for (const Json& repeat : json.at("repeats")) {
    out.repeats.push_back({repeat.at(0), repeat.at(1), repeat.at(2),
                           std::chrono::milliseconds(repeat.at(3).get<std::uint32_t>())});
  }
  out.counts_ids = json.at("counts_ids");
  out.last_msg_id = json.at("last_msg_id");
  out.has_answered = json.at("answered");
  out.is_validated = !json.contains("allowance");
  out.allowance = json.value("allowance", 0U);
  out.uses_client_id = json.at("uses_client_id");
  if (json.contains("saved_ms")) out.saved_at = clock_time(json.at("saved_ms"));
  return out;
}

/// Writes CBOR (RFC 8949) without a tree of values, because each connection saves a session. Maps
/// and arrays have no length in front (section 3.2.2); end() closes the innermost.
class CborWriter {
 public:
  CborWriter() { out_.reserve(short_text); }

  void begin_array() { out_.push_back(0x9f); }
  void begin_map() { out_.push_back(0xbf); }
  void end() { out_.push_back(0xff); }

  void write(bool value) { out_.push_back(value ? 0xf5 : 0xf4); }
  template <std::unsigned_integral Number>
  void write(Number value) {
    write_head(unsigned_type, value);
  }
  void write(std::string_view text) {
    write_head(text_type, text.size());
    append(as_bytes(text));
  }
  void write(const char* text) { write(std::string_view(text)); }
  void write(ByteView octets) {
    write_head(octets_type, octets.size());
    append(octets);
  }

  /// Writes a member of a map.
  template <class Value>
  void write(std::string_view name, const Value& value) {
    write(name);
    write(value);
  }

  /// Returns the octets without spare memory, because thousands of sessions may wait for the disk.
  Bytes take() {
    out_.shrink_to_fit();
    return std::move(out_);
  }

 private:
  /// Octets of a session with one topic: reserved, so that such a session is allocated once.
  static constexpr std::size_t short_text = 512;
  // Major types, section 3.1
  static constexpr std::uint8_t unsigned_type = 0x00;
  static constexpr std::uint8_t octets_type = 0x40;
  static constexpr std::uint8_t text_type = 0x60;

  void write_head(std::uint8_t type, std::uint64_t argument) {
    constexpr unsigned in_head = 24;  // smaller arguments are part of the first octet
    unsigned size_code = 0;           // 2 to this power: octets that follow
    while (size_code < 3 && argument >> (8U << size_code) != 0) ++size_code;
    if (argument < in_head) return out_.push_back(static_cast<std::uint8_t>(type | argument));
    out_.push_back(static_cast<std::uint8_t>(type | (in_head + size_code)));
    for (unsigned shift = 8U << size_code; shift > 0; shift -= 8)
      out_.push_back(static_cast<std::uint8_t>(argument >> (shift - 8)));
  }
  void append(ByteView octets) { out_.insert(out_.end(), octets.begin(), octets.end()); }

  Bytes out_;
};

template <class Duration>
std::uint64_t count_of(Duration duration) {
  return static_cast<std::uint64_t>(duration.count());
}

template <class Enum>
unsigned number_of(Enum value) {
  return static_cast<unsigned>(value);
}

void write(CborWriter& out, const Peer& peer) {
  out.begin_map();
  out.write("address", ByteView(peer.endpoint.address));
  out.write("port", peer.endpoint.port);
  out.write("scope", peer.endpoint.scope_id);
  out.write("node", as_bytes(peer.node_id));
  if (!peer.identity.empty()) out.write("identity", std::string_view(peer.identity));
  out.end();
}

void write(CborWriter& out, const Will& will) {
  out.begin_map();
  out.write("topic", std::string_view(will.topic));
  out.write("message", ByteView(will.message));
  out.write("qos", number_of(will.qos));
  out.write("retain", will.retain);
  out.end();
}

void write(CborWriter& out, const SubscriptionSnapshot& subscription) {
  out.begin_array();
  out.write(std::string_view(subscription.filter));
  out.write(number_of(subscription.qos));
  out.write(number_of(subscription.topic_id_type));
  out.write(subscription.topic_id);
  out.end();
}

void write(CborWriter& out, const MessageSnapshot& message) {
  out.begin_map();
  out.write("topic", std::string_view(message.message.topic));
  out.write("payload", ByteView(message.message.payload));
  out.write("sent_qos", number_of(message.message.qos));
  out.write("retain", message.message.retain);
  out.write("qos", number_of(message.qos));
  out.write("type", number_of(message.topic_id_type));
  out.write("predefined", message.predefined_id);
  out.write("msg_id", message.msg_id);
  if (message.command_age) out.write("command_ms", count_of(*message.command_age));
  out.end();
}

void write(CborWriter& out, const TopicTable::Topic& topic) {
  out.begin_array();
  out.write(std::string_view(topic.name));
  out.write(topic.is_known);
  out.write(topic.is_own);
  out.write(topic.id);
  out.end();
}

void write(CborWriter& out, const RepeatSnapshot& repeat) {
  out.begin_array();
  out.write(repeat.msg_id);
  out.write(repeat.topic_id);
  out.write(repeat.fingerprint);
  out.write(count_of(repeat.age));
  out.end();
}

void write(CborWriter& out, const std::pair<std::uint16_t, std::uint64_t>& inbound) {
  out.begin_array();
  out.write(inbound.first);
  out.write(inbound.second);
  out.end();
}

void write(CborWriter& out, std::uint16_t msg_id) { out.write(msg_id); }

template <class Range>
void write_all(CborWriter& out, std::string_view name, const Range& range) {
  out.write(name);
  out.begin_array();
  for (const auto& element : range) write(out, element);
  out.end();
}

}  // namespace

Bytes encode_session(const SessionSnapshot& snapshot) {
  CborWriter out;
  out.begin_map();
  out.write("version", version);
  out.write("client_id", std::string_view(snapshot.client_id));
  out.write("robot", std::string_view(snapshot.robot));
  out.write("state", number_of(snapshot.state));
  out.write("local", ByteView(snapshot.local.address));
  out.write("interface", snapshot.local.interface);
  out.write("socket", snapshot.local.socket);
  out.write("clean", snapshot.is_clean);
  out.write("uses_client_id", snapshot.uses_client_id);
  out.write("keep_alive_s", count_of(snapshot.keep_alive));
  out.write("sleep_s", count_of(snapshot.sleep_duration));
  write_all(out, "topics", snapshot.topics);
  write_all(out, "subscriptions", snapshot.subscriptions);
  write_all(out, "messages", snapshot.messages);
  write_all(out, "released", snapshot.released);
  write_all(out, "abandoned", snapshot.abandoned);
  write_all(out, "inbound_qos2", snapshot.inbound_qos2);
  write_all(out, "repeats", snapshot.repeats);
  out.write("counts_ids", snapshot.counts_ids);
  out.write("last_msg_id", snapshot.last_msg_id);
  out.write("answered", snapshot.has_answered);
  if (!snapshot.is_validated) out.write("allowance", snapshot.allowance);
  if (snapshot.saved_at)
    out.write(
        "saved_ms",
        count_of(std::chrono::duration_cast<milliseconds>(snapshot.saved_at->time_since_epoch())));
  if (snapshot.peer) {
    out.write("peer");
    write(out, *snapshot.peer);
  }
  if (snapshot.will) {
    out.write("will");
    write(out, *snapshot.will);
  }
  out.end();
  return out.take();
}

std::optional<SessionSnapshot> decode_session(ByteView content) {
  if (!CborBounds(content).hold()) return std::nullopt;
  try {
    const Json json = Json::from_cbor(content.begin(), content.end());
    if (json.at("version").get<unsigned>() != version) return std::nullopt;
    return to_session(json);
  } catch (const Json::exception&) {
    return std::nullopt;
  }
}

}  // namespace slamgw::mqttsn
