// SPDX-License-Identifier: Apache-2.0
// Makes the JSON text that pages get from an MQTT message, and parses the messages of pages. Pure.
//
// To pages: {"topic", "payload", "encoding", "at"} and where they apply "retain": true, "mesh",
// "gateway", "received_at" (user properties of MQTT 5), "bytes" (the payload's size, when it was
// too long to be passed on). `at`: when this program got the message, Unix time in milliseconds.
// `encoding` says what `payload` is: "json" the JSON value itself (a gateway's documents), "text"
// UTF-8 without control characters, "hex" the octets in hexadecimal digits, two each (everything
// else; `update` and `cmd` always, unless they are JSON objects).
//
// Each text is one line: one WebSocket message holds several, with a line feed between them.
//
// Topics that begin with `$web/` come from this program itself: no MQTT subscription matches them.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "web/server/topics.hpp"

namespace slamgw::web {

/// A message from the broker.
struct BrokerMessage {
  std::string topic;
  std::string payload;
  std::int64_t at_ms = 0;
  bool is_retained = false;
  std::string mesh;
  std::string gateway;
  std::string received_at;
};

/// Longest topics and payloads that are passed on. A gateway's numbers hold a line for each of its
/// robots.
inline constexpr std::size_t max_topic = 1024;
inline constexpr std::size_t max_robot_payload = 4096;
inline constexpr std::size_t max_gateway_payload = 2 << 20;
/// A page and the metrics get at most this many robots of a gateway's `numbers`.
inline constexpr std::size_t max_listed_robots = 1000;

/// Returns nothing when the topic is not UTF-8, or too long.
std::optional<std::string> to_page(const BrokerMessage& message, TopicKind kind);
/// Returns a message from this program itself; `payload_json` is JSON text.
std::string own_message(std::string_view name, std::string_view payload_json);
/// Appends json_string(text).
void append_json_text(std::string& out, std::string_view text);

/// The longest message that a page may send, and the longest payload of a command.
inline constexpr std::size_t max_page_message = 4096;
inline constexpr std::size_t max_command_payload = 1024;

struct TokenOffer {
  std::string token;
};
struct CommandRequest {
  std::string topic;
  std::string payload;
  std::string sender{};  ///< the token's name, and the client
};
/// Asks for the History of these robots.
struct HistoryRequest {
  static constexpr std::size_t max_robots = 40;
  std::vector<std::string> robots;
};
/// Asks for the Past. The page has seen everything up to `since_ms`.
struct PastRequest {
  std::int64_t since_ms = 0;
};
struct BadRequest {
  std::string why;
};
using PageMessage =
    std::variant<TokenOffer, CommandRequest, HistoryRequest, PastRequest, BadRequest>;
/// {"topic": "$web/token", "payload": "..."}, {"topic": "$web/history", "payload": [ids]},
/// {"topic": "$web/past", "payload": Unix ms} or {"topic", "payload", "encoding": "text" | "hex"}.
PageMessage parse_page_message(std::string_view text);

}  // namespace slamgw::web
