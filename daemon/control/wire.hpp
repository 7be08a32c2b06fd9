// SPDX-License-Identifier: Apache-2.0
// The control socket's language: a line of JSON each way. Pure; used by ControlServer and
// slam-gatewayctl.
//
//   request   {"command": "status" | "reload" | "fleet"}
//             {"command": "robots" | "mqttsn clients", "robot": optional}
//             {"command": "watch", "robot": optional, "type": optional}
//             {"command": "forget" | "ping", "robot": "..."}
//             {"command": "send", "robot": "...", "type": "...", "payload_hex": "..."}
//             {"command": "ble scan" | "ble nodes" | "ble reset-board"}
//             {"command": "ble export", "address": optional number}
//             {"command": "ble provision", "uuid": "...", "robot": "..."}
//             {"command": "ble permit-join", "minutes": number, "robot": optional}
//             {"command": "ble joining", "after": optional number of an event}
//             {"command": "ble remove", "robot": "...", "force": optional}
//             {"command": "ble config", "robot": "...", "ttl": optional number,
//              "relay": optional true or false, "transmit": optional {"sends", "interval_ms"};
//              null for one of these: the value of all robots; "subscribe" and "unsubscribe":
//              optional number of a group; "publish": optional {"model", "address": null for
//              where all robots publish to}}
//             {"command": "ble refresh-keys", "left_behind": optional [...], "silent": optional,
//              "status": optional}
//             {"command": "ble measure-hearing", "status": optional}
//             {"command": "ble import", "text": "..."}
//             {"command": "store list", "after": optional id, "topic": optional,
//              "payloads": optional}
//             {"command": "store resend" | "store discard", "ids": [...] or "topic": "..." or
//              "all": true}
//   answer    {"result": ...} or {"error": "text"}
//   watch     after its answer, {"event": {...}} for each event (to_json) until the
//             connection ends; an event "lost" counts events that the client was too slow for
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <variant>

#include "daemon/core/bytes.hpp"
#include "daemon/core/operator_order.hpp"
#include "daemon/core/result.hpp"
#include "daemon/core/trace.hpp"

namespace slamgw::control {

struct StatusRequest {};
/// Answered with an array that has a row for each robot, or only for this one.
struct RobotsRequest {
  std::optional<std::string> robot;
};
/// Answered with the changes that took effect and those that need a restart. If the configuration
/// has problems, answered with these, one a line, and nothing changes.
struct ReloadRequest {};
/// Answered with the gateways of this broker and what they serve.
struct FleetRequest {};
/// Answered with the sessions of MQTT-SN, or only with this robot's.
struct MqttsnClientsRequest {
  std::optional<std::string> robot;
};
/// Removes a robot that is offline from the registry and its presence from the broker.
struct ForgetRequest {
  std::string robot;
};
/// Asks a robot on either mesh for one sign of life.
struct PingRequest {
  std::string robot;
};
/// Without a robot: any robot; without a type: any type.
struct WatchRequest {
  std::optional<std::string> robot;
  std::optional<std::string> type;
};
/// Sends a command to a robot; answered with `{"outcome", "after_ms", "why"}`.
struct SendRequest {
  std::string robot;
  std::string type;
  Bytes payload;
};
using Request =
    std::variant<StatusRequest, RobotsRequest, ReloadRequest, FleetRequest, MqttsnClientsRequest,
                 ForgetRequest, PingRequest, WatchRequest, SendRequest, BleOrder, StoreOrder>;

/// Returns the request, or the words that describe its fault.
Result<Request, std::string> parse_request(std::string_view line);

/// Returns a line with its line end. Octets that are not UTF-8 become U+FFFD.
std::string result_line(const nlohmann::json& result);
/// Returns the line that answers an order: its JSON document, or its error.
std::string order_line(const OrderAnswer& answer);
std::string error_line(std::string_view text);
/// A line of `slam-gatewayctl --json watch`; scripts rely on the names. Members that do not apply
/// are left out: `at` (UTC, microseconds), `event`, `robot`, `mesh`, `address`, `topic`, `type`,
/// `direction`, `qos`, `message_id`, `dup`, `bytes`, `rssi_dbm`, `ttl`, `hops`, `latency_us`,
/// `command_id`, `outcome`, `why`, `update`, `payload` (hex), and, where the payload can be decoded
/// so, `cmd` (x and y) and `text`.
nlohmann::ordered_json to_json(const TraceEvent& event);
std::string event_line(const TraceEvent& event);
/// Replaces `count` events that a watcher was too slow for: `at`, `event` "lost", `lost`.
std::string lost_line(std::uint64_t count, WallTime at);
std::string to_line(const nlohmann::json& json);

}  // namespace slamgw::control
