// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/clients/session_codec.hpp"

#include <algorithm>
#include <nlohmann/json.hpp>

namespace slamgw::mqttsn {
namespace {

using Json = nlohmann::json;

constexpr int version = 1;

using std::chrono::milliseconds;

/// Of the monotonic clock; one that its type can't hold becomes the latest that we take.
TimePoint clock_time(const Json& json) {
  constexpr std::uint64_t latest_ms = 1'000'000'000'000;  // 31 years after the host's start
  return TimePoint(milliseconds(std::min(json.get<std::uint64_t>(), latest_ms)));
}

std::int64_t clock_ms(TimePoint time) {
  return std::chrono::duration_cast<milliseconds>(time.time_since_epoch()).count();
}

Json binary(ByteView octets) { return Json::binary(Bytes(octets.begin(), octets.end())); }

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

Json to_json(const Peer& peer) {
  return {{"address", binary(peer.endpoint.address)},
          {"port", peer.endpoint.port},
          {"scope", peer.endpoint.scope_id},
          {"node", binary(as_bytes(peer.node_id))}};
}

Peer to_peer(const Json& json) {
  const Bytes node = octets(json.at("node"));
  return {{address(json.at("address")), json.at("port"), json.at("scope")},
          std::string(node.begin(), node.end())};
}

Json to_json(const Will& will) {
  return {{"topic", will.topic},
          {"message", binary(will.message)},
          {"qos", will.qos},
          {"retain", will.retain}};
}

Will to_will(const Json& json) {
  return {json.at("topic"), octets(json.at("message")), checked(json.at("qos"), Qos::exactly_once),
          json.at("retain")};
}

Json to_json(const SubscriptionSnapshot& s) {
  return Json::array({s.filter, s.qos, s.topic_id_type, s.topic_id});
}

SubscriptionSnapshot to_subscription(const Json& json) {
  return {json.at(0), checked(json.at(1), Qos::exactly_once),
          checked(json.at(2), TopicIdType::short_name), json.at(3)};
}

Json to_json(const MessageSnapshot& m) {
  Json json{{"topic", m.message.topic},
            {"payload", binary(m.message.payload)},
            {"sent_qos", m.message.qos},
            {"retain", m.message.retain},
            {"qos", m.qos},
            {"type", m.topic_id_type},
            {"predefined", m.predefined_id},
            {"msg_id", m.msg_id},
            {"released", false}};  // for versions that keep the message until PUBCOMP
  if (m.command_age) json["command_ms"] = m.command_age->count();
  return json;
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

Json to_json(const TopicTable::Topic& topic) {
  return Json::array({topic.name, topic.is_told, topic.is_own});
}

/// Sessions of former versions do not say whose a topic is: then it keeps its id.
TopicTable::Topic to_topic(const Json& json) {
  return {json.at(0), json.at(1), json.size() < 3 || json.at(2).get<bool>()};
}

Json to_json(const RepeatSnapshot& repeat) {
  return Json::array({repeat.msg_id, repeat.topic_id, repeat.fingerprint, repeat.age.count()});
}

Json to_json(const std::pair<std::uint16_t, std::uint64_t>& inbound) {
  return Json::array({inbound.first, inbound.second});
}

template <class Range>
Json to_array(const Range& range) {
  Json array = Json::array();
  for (const auto& element : range) array.push_back(to_json(element));
  return array;
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
  for (const Json& message : json.at("messages")) {
    // Sessions of 0.1 keep a message until PUBCOMP.
    if (message.at("released").get<bool>()) {
      out.released.push_back(message.at("msg_id"));
    } else {
      out.messages.push_back(to_message(message));
    }
  }
  if (json.contains("released")) out.released = json.at("released").get<decltype(out.released)>();
  for (const Json& inbound : json.at("inbound_qos2"))
    out.inbound_qos2.emplace_back(inbound.at(0), inbound.at(1));
  for (const Json& repeat : json.at("repeats")) {
    out.repeats.push_back({repeat.at(0), repeat.at(1), repeat.at(2),
                           std::chrono::milliseconds(repeat.at(3).get<std::uint32_t>())});
  }
  out.last_msg_id = json.at("last_msg_id");
  out.is_validated = !json.contains("allowance");
  out.allowance = json.value("allowance", 0U);
  out.uses_client_id = json.value("uses_client_id", false);
  if (json.contains("saved_ms")) out.saved_at = clock_time(json.at("saved_ms"));
  return out;
}

}  // namespace

Bytes encode_session(const SessionSnapshot& snapshot) {
  Json json{{"version", version},
            {"client_id", snapshot.client_id},
            {"robot", snapshot.robot},
            {"state", snapshot.state},
            {"local", binary(snapshot.local.address)},
            {"interface", snapshot.local.interface},
            {"socket", snapshot.local.socket},
            {"clean", snapshot.is_clean},
            {"uses_client_id", snapshot.uses_client_id},
            {"keep_alive_s", snapshot.keep_alive.count()},
            {"sleep_s", snapshot.sleep_duration.count()},
            {"topics", to_array(snapshot.topics)},
            {"subscriptions", to_array(snapshot.subscriptions)},
            {"messages", to_array(snapshot.messages)},
            {"released", snapshot.released},
            {"inbound_qos2", to_array(snapshot.inbound_qos2)},
            {"repeats", to_array(snapshot.repeats)},
            {"last_msg_id", snapshot.last_msg_id}};
  if (snapshot.peer) json["peer"] = to_json(*snapshot.peer);
  if (!snapshot.is_validated) json["allowance"] = snapshot.allowance;
  if (snapshot.saved_at) json["saved_ms"] = clock_ms(*snapshot.saved_at);
  if (snapshot.will) json["will"] = to_json(*snapshot.will);
  return Json::to_cbor(json);
}

std::optional<SessionSnapshot> decode_session(ByteView content) {
  try {
    const Json json = Json::from_cbor(content.begin(), content.end());
    if (json.at("version").get<int>() != version) return std::nullopt;
    return to_session(json);
  } catch (const Json::exception&) {
    return std::nullopt;
  }
}

}  // namespace slamgw::mqttsn
