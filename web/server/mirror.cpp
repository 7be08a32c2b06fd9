// SPDX-License-Identifier: Apache-2.0
#include "web/server/mirror.hpp"

#include <algorithm>
#include <array>
#include <nlohmann/json.hpp>

#include "daemon/core/announcements.hpp"
#include "daemon/core/bytes.hpp"
#include "daemon/core/utf8.hpp"

namespace slamgw::web {
namespace {

using nlohmann::json;

bool is_plain_text(std::string_view text) {
  return !text.empty() && is_utf8(text) && std::none_of(text.begin(), text.end(), [](char c) {
    return static_cast<unsigned char>(c) < 0x20 || c == '\x7f';
  });
}

/// Gateways' documents have four levels. Browsers fail to turn thousands of levels into text.
bool is_deep(std::string_view text) {
  constexpr int max_depth = 32;
  int depth = 0;
  bool is_in_string = false;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (c == '"') is_in_string = !is_in_string;
    if (is_in_string && c == '\\') ++i;
    if (is_in_string) continue;
    if (c == '[' || c == '{') ++depth;
    if (c == ']' || c == '}') --depth;
    if (depth > max_depth) return true;
  }
  return false;
}

/// Returns whether the text, if it is JSON, may stand inside another document. The parser stops at
/// a NUL and skips a byte order mark. Neither may reach a page: its browser would close the
/// connection or refuse the message.
bool is_embeddable(std::string_view text) {
  constexpr std::string_view byte_order_mark = "\xef\xbb\xbf";
  return is_utf8(text) && text.find('\0') == text.npos && !text.starts_with(byte_order_mark) &&
         !is_deep(text);
}

constexpr std::array<std::string_view, 17> texts{
    "state",   "mesh",      "why",          "detail", "version",         "gateway",
    "address", "last_seen", "last_heard",   "type",   "outcome",         "what",
    "grant",   "role",      "network_name", "rloc16", "extended_address"};
constexpr std::array<std::string_view, 6> groups{"broker",   "meshes", "store",
                                                 "messages", "queue",  "counters"};

/// Returns whether the member has the type that pages and metrics expect. JavaScript calls the
/// three names below as functions: an object with such a member cannot even be turned into text.
bool is_usable(const std::string& key, const json& value) {
  if (key == "toString" || key == "valueOf" || key == "toJSON") return false;
  if (value.is_null()) return true;
  if (std::ranges::count(texts, key) > 0) return value.is_string();
  if (std::ranges::count(groups, key) > 0) return value.is_object();
  return (key != "missing_rights" && key != "neighbours") || value.is_array();
}

/// Removes members whose type differs from docs/topics.md; returns whether any did. `has_names`:
/// the keys are robots' names, which may also be `state` or `toString`.
bool drop_unusable(json& document, bool has_names = false) {
  bool has_dropped = false;
  if (document.is_array())
    for (json& each : document) has_dropped |= drop_unusable(each);
  if (!document.is_object()) return has_dropped;
  for (auto member = document.begin(); member != document.end();) {
    const std::string& key = member.key();
    const bool is_fine = has_names || is_usable(key, member.value());
    has_dropped |= is_fine ? drop_unusable(member.value(), key == "robots") : true;
    member = is_fine ? std::next(member) : document.erase(member);
  }
  return has_dropped;
}

/// Removes robots beyond the number that a gateway may list (docs/topics.md), and counts them as
/// left out.
bool drop_surplus(json& numbers) {
  const auto robots = numbers.find("robots");
  if (robots == numbers.end() || !robots->is_object() || robots->size() <= max_listed_robots)
    return false;
  const std::size_t surplus = robots->size() - max_listed_robots;
  robots->erase(std::next(robots->begin(), max_listed_robots), robots->end());
  json& left_out = numbers["left_out"];
  left_out = (left_out.is_number_unsigned() ? left_out.get<std::uint64_t>() : 0) + surplus;
  return true;
}

/// Only `numbers` grow with the number of robots; a page keeps thousands of other documents.
std::size_t longest_payload(std::string_view topic, TopicKind kind) {
  constexpr std::size_t max_state_payload = 64 * 1024;
  if (kind != TopicKind::state) return max_robot_payload;
  return topic.ends_with("/numbers") ? max_gateway_payload : max_state_payload;
}

/// Returns whether the payload is octets: positions are, even if they happen to look like text.
bool is_octets(std::string_view topic, std::string_view payload) {
  const std::string_view type = topic.substr(topic.rfind('/') + 1);
  return (type == "update" || type == "cmd") && !payload.starts_with('{');
}

void append_payload(std::string& out, const BrokerMessage& message, TopicKind kind) {
  const bool is_gateways = kind == TopicKind::state || kind == TopicKind::event;
  const std::string_view payload = message.payload;
  json document = is_gateways && is_embeddable(payload) ? json::parse(payload, nullptr, false)
                                                        : json(json::value_t::discarded);
  if (!document.is_discarded()) {
    const auto begin = static_cast<std::ptrdiff_t>(out.size());
    const bool is_cut = drop_surplus(document);
    if (drop_unusable(document) || is_cut) {
      out.append(document.dump());
    } else {
      out.append(payload);
    }
    // A message is one line; a line feed in JSON is only ever a space between tokens.
    std::replace(out.begin() + begin, out.end(), '\n', ' ');
    out.append(R"(,"encoding":"json")");
  } else if (!is_octets(message.topic, payload) && is_plain_text(payload)) {
    append_json_text(out, payload);
    out += R"(,"encoding":"text")";
  } else {
    out.append("\"").append(to_hex(as_bytes(payload))).append(R"(","encoding":"hex")");
  }
}

void append_member(std::string& out, std::string_view name, std::string_view text) {
  if (text.empty() || !is_utf8(text)) return;
  out.append(",\"").append(name).append("\":");
  append_json_text(out, text);
}

const std::string* text_of(const json& object, const char* key) {
  const auto found = object.find(key);
  return found == object.end() ? nullptr : found->get_ptr<const std::string*>();
}

HistoryRequest parse_history_request(const json& document) {
  HistoryRequest request;
  const auto robots = document.find("payload");
  if (robots == document.end() || !robots->is_array()) return request;
  for (const json& robot : *robots) {
    const auto* id = robot.get_ptr<const std::string*>();
    if (id != nullptr && request.robots.size() < HistoryRequest::max_robots)
      request.robots.push_back(*id);
  }
  return request;
}

}  // namespace

void append_json_text(std::string& out, std::string_view text) { out += json_string(text); }

std::optional<std::string> to_page(const BrokerMessage& message, TopicKind kind) {
  if (message.topic.size() > max_topic || !is_utf8(message.topic)) return std::nullopt;
  const std::size_t longest = longest_payload(message.topic, kind);
  std::string out = R"({"topic":)";
  out.reserve(message.topic.size() + 2 * std::min(message.payload.size(), longest) + 192);
  append_json_text(out, message.topic);
  out += R"(,"payload":)";
  if (message.payload.size() > longest) {
    out += R"("","encoding":"hex","bytes":)" + std::to_string(message.payload.size());
  } else {
    append_payload(out, message, kind);
  }
  out += R"(,"at":)" + std::to_string(message.at_ms);
  if (message.is_retained) out += R"(,"retain":true)";
  append_member(out, "mesh", message.mesh);
  append_member(out, "gateway", message.gateway);
  append_member(out, "received_at", message.received_at);
  out += '}';
  return out;
}

std::string own_message(std::string_view name, std::string_view payload_json) {
  std::string out = R"({"topic":)";
  append_json_text(out, std::string("$web/").append(name));
  return out.append(R"(,"payload":)").append(payload_json).append("}");
}

PageMessage parse_page_message(std::string_view text) {
  constexpr const char* shape = R"(not {"topic": "...", "payload": "..."})";
  if (text.size() > max_page_message) return BadRequest{"too long"};
  const json document = json::parse(text, nullptr, false);
  if (!document.is_object()) return BadRequest{shape};
  const std::string* topic = text_of(document, "topic");
  if (topic != nullptr && *topic == "$web/history") return parse_history_request(document);
  if (topic != nullptr && *topic == "$web/past") {
    const auto since = document.find("payload");
    const bool is_known = since != document.end() && since->is_number_integer();
    return PastRequest{is_known ? since->get<std::int64_t>() : 0};
  }
  const std::string* payload = text_of(document, "payload");
  if (topic == nullptr || payload == nullptr) return BadRequest{shape};
  if (*topic == "$web/token") return TokenOffer{*payload};
  const std::string* named = text_of(document, "encoding");
  const std::string encoding = named == nullptr ? "text" : *named;
  if (encoding != "text" && encoding != "hex") return BadRequest{"encoding is not text or hex"};
  const auto octets = encoding == "hex" ? from_hex(*payload) : std::optional(to_bytes(*payload));
  if (!octets) return BadRequest{"the payload is not in hexadecimal digits, two for each octet"};
  if (octets->size() > max_command_payload) return BadRequest{"the payload is too long"};
  return CommandRequest{*topic, std::string(as_text(*octets))};
}

}  // namespace slamgw::web
