// SPDX-License-Identifier: Apache-2.0
#include "daemon/control/wire.hpp"

#include <nlohmann/json.hpp>

#include <fmt/format.h>

#include <algorithm>
#include <iterator>

#include "daemon/core/utf8.hpp"

namespace slamgw::control {
namespace {

using nlohmann::json;
using Json = nlohmann::ordered_json;

std::optional<std::string> text_of(const json& request, const char* key) {
  const auto found = request.find(key);
  if (found == request.end() || !found->is_string()) return std::nullopt;
  return found->get<std::string>();
}

/// Returns 0 when the member is missing or not an unsigned number.
std::uint64_t number_of(const json& request, const char* key) {
  const auto found = request.find(key);
  return found != request.end() && found->is_number_unsigned() ? found->get<std::uint64_t>() : 0;
}

bool is_true(const json& request, const char* key) {
  const auto found = request.find(key);
  return found != request.end() && *found == true;
}

Result<Request, std::string> parse_send(const json& request) {
  const auto robot = text_of(request, "robot");
  const auto type = text_of(request, "type");
  const auto payload_hex = text_of(request, "payload_hex");
  const auto payload = payload_hex ? from_hex(*payload_hex) : std::nullopt;
  if (!robot || !type || !payload) {
    return std::string("send needs the texts robot, type and payload_hex (pairs of hex digits)");
  }
  return Request(SendRequest{*robot, *type, *payload});
}

/// Refers to slam-gatewayctl, whose commands for the daemon are those of this socket.
std::string unknown(const std::string& command) {
  return fmt::format("unknown command '{}'; slam-gatewayctl --help lists all", command);
}

/// Reads an optional member; null wishes for the value of all robots. False when it is invalid.
template <class Value, class Read>
bool read_wish(const json& request, const char* key, NodeConfigOrder::Wish<Value>& wish,
               const Read& read) {
  const auto found = request.find(key);
  if (found == request.end()) return true;
  wish.emplace(found->is_null() ? std::nullopt : read(*found));
  return found->is_null() || wish->has_value();
}

std::optional<std::uint8_t> read_ttl(const json& value) {
  constexpr std::uint64_t most = 127;  // Mesh Profile 1.0 section 4.2.7; 1 is prohibited
  if (!value.is_number_unsigned() || value == 1U || value > most) return std::nullopt;
  return value.get<std::uint8_t>();
}

std::optional<bool> read_relay(const json& value) {
  return value.is_boolean() ? std::optional(value.get<bool>()) : std::nullopt;
}

std::optional<Transmissions> read_transmissions(const json& value) {
  if (!value.is_object()) return std::nullopt;
  const std::uint64_t sends = number_of(value, "sends");
  const std::uint64_t interval_ms = number_of(value, "interval_ms");
  if (!Transmissions::is_valid(sends, interval_ms)) return std::nullopt;
  return Transmissions{static_cast<std::uint8_t>(sends), static_cast<std::uint16_t>(interval_ms)};
}

/// Returns false when the member exists but is not a group address.
bool read_group(const json& request, const char* key, std::optional<std::uint16_t>& group) {
  constexpr std::uint64_t first = 0xc000;
  constexpr std::uint64_t last = 0xfeff;
  if (!request.contains(key)) return true;
  const std::uint64_t number = number_of(request, key);
  if (number < first || number > last) return false;
  group = static_cast<std::uint16_t>(number);
  return true;
}

/// Returns false when the member exists but is not a publication: a model and an address, or null
/// for the address to which all robots publish.
bool read_publication(const json& request,
                      std::optional<NodeConfigOrder::Publication>& publication) {
  const auto found = request.find("publish");
  if (found == request.end()) return true;
  const auto model = found->is_object() ? text_of(*found, "model") : std::nullopt;
  const auto address = found->is_object() ? found->find("address") : found->end();
  if (!model || address == found->end()) return false;
  publication = NodeConfigOrder::Publication{*model, std::nullopt};
  if (address->is_null()) return true;
  const std::uint64_t number = number_of(*found, "address");
  publication->address = static_cast<std::uint16_t>(number);
  return NodeConfigOrder::Publication::is_valid(number);
}

Result<Request, std::string> parse_node_config(const json& request) {
  const auto robot = text_of(request, "robot");
  if (!robot) return std::string("ble config needs the text robot");
  NodeConfigOrder order{*robot};
  if (!read_wish(request, "ttl", order.ttl, read_ttl))
    return std::string("ttl is 0 or 2 to 127, or null");
  if (!read_wish(request, "relay", order.relay, read_relay))
    return std::string("relay is true, false or null");
  if (!read_wish(request, "transmit", order.transmit, read_transmissions))
    return std::string("transmit is null or has sends (1 to 8) and interval_ms (10, 20 ... 320)");
  if (!read_group(request, "subscribe", order.subscribe) ||
      !read_group(request, "unsubscribe", order.unsubscribe))
    return std::string("subscribe and unsubscribe are groups, 49152 to 65279 (0xc000-0xfeff)");
  if (!read_publication(request, order.publish))
    return std::string("publish has a model and an address: null, 1 to 32767 or 49152 to 65279");
  return Request(std::move(order));
}

Result<Request, std::string> parse_refresh(const json& request) {
  RefreshKeysOrder order{{}, is_true(request, "silent"), is_true(request, "status")};
  const auto left = request.find("left_behind");
  if (left == request.end()) return Request(order);
  if (!left->is_array() || !std::ranges::all_of(*left, &json::is_string))
    return std::string("ble refresh-keys takes a list of robots as left_behind");
  order.left_behind = left->get<std::vector<std::string>>();
  return Request(order);
}

Result<Request, std::string> parse_order(const std::string& command, const json& request) {
  const auto robot = text_of(request, "robot");
  const auto uuid = text_of(request, "uuid");
  const auto text = text_of(request, "text");
  if (command == "ble scan") return Request(ScanOrder{});
  if (command == "ble nodes") return Request(NodesOrder{});
  if (command == "ble export") {
    constexpr std::uint64_t last_unicast_address = 0x7fff;
    const std::uint64_t address = number_of(request, "address");
    if (address > last_unicast_address)
      return std::string("ble export takes a unicast address, up to 0x7fff");
    return Request(ExportOrder{static_cast<std::uint16_t>(address)});
  }
  if (command == "ble reset-board") return Request(ResetBoardOrder{});
  if (command == "ble provision") {
    if (!uuid || !robot) return std::string("ble provision needs the texts uuid and robot");
    return Request(ProvisionOrder{*uuid, *robot});
  }
  if (command == "ble permit-join") {
    const auto minutes = request.find("minutes");
    if (minutes == request.end() || !minutes->is_number_unsigned())
      return std::string("ble permit-join needs the number minutes");
    constexpr auto most = std::chrono::minutes(PermitJoinOrder::longest).count();
    const auto count = std::min<std::uint64_t>(minutes->get<std::uint64_t>(), most);
    return Request(PermitJoinOrder{std::chrono::minutes(count), robot.value_or("")});
  }
  if (command == "ble joining") return Request(JoinEventsOrder{number_of(request, "after")});
  if (command == "ble remove") {
    if (!robot) return std::string("ble remove needs the text robot");
    return Request(RemoveOrder{*robot, is_true(request, "force")});
  }
  if (command == "ble config") return parse_node_config(request);
  if (command == "ble measure-hearing")
    return Request(MeasureHearingOrder{is_true(request, "status")});
  if (command == "ble refresh-keys") return parse_refresh(request);
  if (command == "ble import") {
    if (!text) return std::string("ble import needs the text of the file as text");
    return Request(ImportOrder{*text});
  }
  return unknown(command);
}

std::optional<DeadLetterChoice> parse_choice(const json& request) {
  DeadLetterChoice choice;
  choice.topic = text_of(request, "topic").value_or("");
  choice.is_all = is_true(request, "all");
  const auto ids = request.find("ids");
  if (ids != request.end()) {
    if (!ids->is_array()) return std::nullopt;
    for (const json& id : *ids) {
      if (!id.is_number_unsigned()) return std::nullopt;
      choice.ids.push_back(id.get<std::uint64_t>());
    }
  }
  const int ways = (choice.ids.empty() ? 0 : 1) + (choice.topic.empty() ? 0 : 1) + choice.is_all;
  if (ways != 1) return std::nullopt;
  return choice;
}

Result<Request, std::string> parse_store_order(const std::string& command, const json& request) {
  if (command == "store list") {
    return Request(ListDeadLetters{number_of(request, "after"),
                                   text_of(request, "topic").value_or(""),
                                   is_true(request, "payloads")});
  }
  if (command != "store resend" && command != "store discard") return unknown(command);
  const auto choice = parse_choice(request);
  if (!choice) return command + " needs one of: ids (numbers), topic (a text), all (true)";
  if (command == "store resend") return Request(ResendOrder{*choice});
  return Request(DiscardOrder{*choice});
}

void add_text(Json& out, const char* name, const std::string& text) {
  if (!text.empty()) out[name] = text;
}

template <class T>
void add(Json& out, const char* name, const std::optional<T>& value) {
  if (value) out[name] = *value;
}

void add_radio(Json& out, const std::optional<RadioFacts>& radio) {
  if (!radio) return;
  add(out, "rssi_dbm", radio->rssi_dbm);
  add(out, "ttl", radio->ttl);
  add(out, "hops", radio->hops);
}

/// Adds the payload as hex and, where it can be decoded so, as the thesis's command (two int16) and
/// as text.
void add_payload(Json& out, const TraceEvent& event) {
  if (event.update) out["update"] = Json::parse(encode_json(*event.update));
  if (!event.payload) return;
  out["payload"] = to_hex(*event.payload);
  if (event.type == "cmd" && event.payload->size() == 4) {
    ByteReader reader(*event.payload);
    out["cmd"]["x"] = reader.read_i16_le();
    out["cmd"]["y"] = reader.read_i16_le();
  }
  const std::string_view text = as_text(*event.payload);
  if (is_printable(text)) out["text"] = text;
}

std::string ordered_line(const Json& document) {
  return escape_unprintable(document.dump(-1, ' ', false, Json::error_handler_t::replace)) + "\n";
}

}  // namespace

Result<Request, std::string> parse_request(std::string_view line) {
  const json request = json::parse(line, nullptr, false);
  const auto command = request.is_object() ? text_of(request, "command") : std::nullopt;
  if (!command) return std::string("a request is a line like {\"command\": \"status\"}");
  if (*command == "status") return Request(StatusRequest{});
  if (*command == "robots") return Request(RobotsRequest{text_of(request, "robot")});
  if (*command == "reload") return Request(ReloadRequest{});
  if (*command == "fleet") return Request(FleetRequest{});
  if (*command == "mqttsn clients") return Request(MqttsnClientsRequest{text_of(request, "robot")});
  if (*command == "send") return parse_send(request);
  if (*command == "forget" || *command == "ping") {
    const auto robot = text_of(request, "robot");
    if (!robot) return *command + " needs the text robot";
    if (*command == "ping") return Request(PingRequest{*robot});
    return Request(ForgetRequest{*robot});
  }
  if (*command == "watch")
    return Request(WatchRequest{text_of(request, "robot"), text_of(request, "type")});
  if (command->starts_with("ble ")) return parse_order(*command, request);
  if (command->starts_with("store ")) return parse_store_order(*command, request);
  return unknown(*command);
}

Json to_json(const TraceEvent& event) {
  Json out{{"at", to_iso8601_us(event.at)}, {"event", to_string(event.kind)}};
  add_text(out, "robot", event.robot);
  if (event.mesh) out["mesh"] = to_string(*event.mesh);
  add_text(out, "address", event.address);
  add_text(out, "topic", event.topic);
  add_text(out, "type", event.type);
  out["direction"] = is_down(event.kind) ? "down" : "up";
  if (event.qos) out["qos"] = static_cast<int>(*event.qos);
  add(out, "message_id", event.wire.message_id);
  add(out, "dup", event.wire.is_dup);
  add(out, "bytes", event.bytes);
  add_radio(out, event.radio);
  if (event.latency) out["latency_us"] = event.latency->count();
  if (event.command != CommandId::none)
    out["command_id"] = static_cast<std::uint64_t>(event.command);
  if (event.outcome) out["outcome"] = to_string(*event.outcome);
  add_text(out, "why", event.why);
  if (event.had_stray_octet) out["stray_octet"] = true;
  add_payload(out, event);
  return out;
}

std::string result_line(const json& result) { return to_line({{"result", result}}); }
std::string order_line(const OrderAnswer& answer) {
  if (!answer.error.empty()) return error_line(answer.error);
  return result_line(json::parse(answer.json, nullptr, false));
}
std::string error_line(std::string_view text) { return to_line({{"error", text}}); }
std::string event_line(const TraceEvent& event) {
  return ordered_line({{"event", to_json(event)}});
}
std::string lost_line(std::uint64_t count, WallTime at) {
  return ordered_line({{"event", {{"at", to_iso8601_us(at)}, {"event", "lost"}, {"lost", count}}}});
}

std::string to_line(const json& json) {
  return escape_unprintable(json.dump(-1, ' ', false, json::error_handler_t::replace)) + "\n";
}

}  // namespace slamgw::control
