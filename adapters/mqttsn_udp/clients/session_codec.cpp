// SPDX-License-Identifier: Apache-2.0
// A session's snapshot as octets, and back.
#include <nlohmann/json.hpp>

#include <algorithm>
#include <concepts>
#include <tuple>

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

[[noreturn]] void refuse(const char* what) { throw Json::other_error::create(501, what, nullptr); }

// The fields of a session, each listed once for reading and writing. members() lists the members of
// a map, items() the elements of an array, in the order in which they are written.

void members(auto& io, Peer& peer) {
  io("address", peer.endpoint.address);
  io("port", peer.endpoint.port);
  io("scope", peer.endpoint.scope_id);
  Bytes node = to_bytes(peer.node_id);
  io("node", node);
  peer.node_id = as_text(node);
  if (io.has("identity", !peer.identity.empty())) io("identity", peer.identity);
}

void members(auto& io, Will& will) {
  io("topic", will.topic);
  io("message", will.message);
  io("qos", will.qos);
  io("retain", will.retain);
}

void members(auto& io, MessageSnapshot& message) {
  io("topic", message.message.topic);
  io("payload", message.message.payload);
  io("sent_qos", message.message.qos);
  io("retain", message.message.retain);
  io("qos", message.qos);
  io("type", message.topic_id_type);
  io("predefined", message.predefined_id);
  io("msg_id", message.msg_id);
  io.optional("command_ms", message.command_age);
}

auto items(SubscriptionSnapshot& s) {
  return std::tie(s.filter, s.qos, s.topic_id_type, s.topic_id);
}
auto items(TopicTable::Topic& t) { return std::tie(t.name, t.is_known, t.is_own, t.id); }
auto items(RepeatSnapshot& r) { return std::tie(r.msg_id, r.topic_id, r.fingerprint, r.age); }
auto items(std::pair<std::uint16_t, std::uint64_t>& inbound) {
  return std::tie(inbound.first, inbound.second);
}

void members(auto& io, SessionSnapshot& s) {
  unsigned written_version = version;
  io("version", written_version);
  if (written_version != version) refuse("version");
  io("client_id", s.client_id);
  io("robot", s.robot);
  io("state", s.state);
  io("local", s.local.address);
  io("interface", s.local.interface);
  io("socket", s.local.socket);
  io("clean", s.is_clean);
  io("uses_client_id", s.uses_client_id);
  io("keep_alive_s", s.keep_alive);
  io("sleep_s", s.sleep_duration);
  io("topics", s.topics);
  io("subscriptions", s.subscriptions);
  io("messages", s.messages);
  io("released", s.released);
  if (io.has("abandoned", true)) io("abandoned", s.abandoned);
  io("inbound_qos2", s.inbound_qos2);
  io("repeats", s.repeats);
  io("counts_ids", s.counts_ids);
  io("last_msg_id", s.last_msg_id);
  io("answered", s.has_answered);
  s.is_validated = !io.has("allowance", !s.is_validated);
  if (!s.is_validated) io("allowance", s.allowance);
  io.optional("saved_ms", s.saved_at);
  io.optional("peer", s.peer);
  io.optional("will", s.will);
}

template <class Value>
concept Listed = requires(Value& value) {
  items(value);
};

template <class Value>
concept Enum = std::is_enum_v<Value>;

constexpr Qos last_of(Qos) { return Qos::exactly_once; }
constexpr TopicIdType last_of(TopicIdType) { return TopicIdType::short_name; }
constexpr ClientState last_of(ClientState) { return ClientState::lost; }

/// Reads the members of a map. Throws Json::exception when one is missing or unreadable.
class JsonReader {
 public:
  explicit JsonReader(const Json& map) : map_(map) {}

  void operator()(const char* name, auto& value) { take(map_.at(name), value); }
  bool has(const char* name, bool) const { return map_.contains(name); }
  template <class Value>
  void optional(const char* name, std::optional<Value>& value) {
    if (has(name, {})) take(map_.at(name), *(value = Value{}));
  }

  static void take(const Json& map, auto& record) {
    JsonReader reader(map);
    members(reader, record);
  }

 private:
  static void take(const Json& json, std::string& text) { json.get_to(text); }
  static void take(const Json& json, std::integral auto& number) { json.get_to(number); }
  static void take(const Json& json, Bytes& octets) { octets = json.get_binary(); }
  static void take(const Json& json, IpAddress& address) {
    const Bytes& octets = json.get_binary();
    if (octets.size() != address.size()) refuse("address");
    std::ranges::copy(octets, address.begin());
  }
  static void take(const Json& json, Enum auto& value) {
    const auto number = json.get<unsigned>();
    if (number > static_cast<unsigned>(last_of(value))) refuse("range");
    value = static_cast<std::remove_reference_t<decltype(value)>>(number);
  }
  template <class Period>
  static void take(const Json& json, std::chrono::duration<std::int64_t, Period>& duration) {
    duration = std::chrono::duration<std::int64_t, Period>(json.get<std::uint32_t>());
  }
  /// A time that the type can't hold becomes `latest_ms`.
  static void take(const Json& json, TimePoint& time) {
    constexpr std::uint64_t latest_ms = 1'000'000'000'000;  // 31 years after the host's start
    time = TimePoint(milliseconds(std::min(json.get<std::uint64_t>(), latest_ms)));
  }
  template <class Value>
  static void take(const Json& json, std::vector<Value>& values) {
    for (const Json& each : json) take(each, values.emplace_back());
  }
  static void take(const Json& array, Listed auto& record) {
    std::size_t at = 0;
    std::apply([&](auto&... each) { (take(array.at(at++), each), ...); }, items(record));
  }

  const Json& map_;
};

/// Writes CBOR (RFC 8949) without a tree of values, because each connection saves a session. Maps
/// and arrays have no length in front (section 3.2.2); an octet ends them.
class CborWriter {
 public:
  CborWriter() { out_.reserve(short_text); }

  void operator()(std::string_view name, auto& value) {
    put(name);
    put(value);
  }
  static bool has(std::string_view, bool is_set) { return is_set; }
  template <class Value>
  void optional(std::string_view name, std::optional<Value>& value) {
    if (value) (*this)(name, *value);
  }

  void put(auto& record) {
    out_.push_back(begin_map);
    members(*this, record);
    out_.push_back(end);
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
  static constexpr std::uint8_t begin_array = 0x9f;
  static constexpr std::uint8_t begin_map = 0xbf;
  static constexpr std::uint8_t end = 0xff;

  void put(bool& value) { out_.push_back(value ? 0xf5 : 0xf4); }
  void put(std::unsigned_integral auto& number) { put_head(unsigned_type, number); }
  void put(std::string_view text) { put_octets(text_type, as_bytes(text)); }
  void put(std::string& text) { put(std::string_view(text)); }
  void put(ByteView octets) { put_octets(octets_type, octets); }
  void put(Bytes& octets) { put(ByteView(octets)); }
  void put(IpAddress& address) { put(ByteView(address)); }
  void put(Enum auto& value) { put_head(unsigned_type, static_cast<unsigned>(value)); }
  template <class Period>
  void put(std::chrono::duration<std::int64_t, Period>& duration) {
    put_head(unsigned_type, static_cast<std::uint64_t>(duration.count()));
  }
  void put(TimePoint& time) {
    auto since_start = std::chrono::duration_cast<milliseconds>(time.time_since_epoch());
    put(since_start);
  }
  template <class Value>
  void put(std::vector<Value>& values) {
    out_.push_back(begin_array);
    for (Value& each : values) put(each);
    out_.push_back(end);
  }
  void put(Listed auto& record) {
    out_.push_back(begin_array);
    std::apply([&](auto&... each) { (put(each), ...); }, items(record));
    out_.push_back(end);
  }

  void put_head(std::uint8_t type, std::uint64_t argument) {
    constexpr unsigned in_head = 24;  // smaller arguments are part of the first octet
    unsigned size_code = 0;           // 2 to this power: octets that follow
    while (size_code < 3 && argument >> (8U << size_code) != 0) ++size_code;
    if (argument < in_head) return out_.push_back(static_cast<std::uint8_t>(type | argument));
    out_.push_back(static_cast<std::uint8_t>(type | (in_head + size_code)));
    for (unsigned shift = 8U << size_code; shift > 0; shift -= 8)
      out_.push_back(static_cast<std::uint8_t>(argument >> (shift - 8)));
  }
  void put_octets(std::uint8_t type, ByteView octets) {
    put_head(type, octets.size());
    out_.insert(out_.end(), octets.begin(), octets.end());
  }

  Bytes out_;
};

}  // namespace

Bytes encode_session(SessionSnapshot snapshot) {
  CborWriter out;
  out.put(snapshot);
  return out.take();
}

std::optional<SessionSnapshot> decode_session(ByteView content) {
  if (!CborBounds(content).hold()) return std::nullopt;
  try {
    SessionSnapshot snapshot;
    JsonReader::take(Json::from_cbor(content.begin(), content.end()), snapshot);
    return snapshot;
  } catch (const Json::exception&) {
    return std::nullopt;
  }
}

}  // namespace slamgw::mqttsn
