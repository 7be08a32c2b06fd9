// SPDX-License-Identifier: Apache-2.0
#include "daemon/control/trace_json.hpp"

#include "daemon/core/utf8.hpp"

namespace slamgw::control {
namespace {

using Json = nlohmann::ordered_json;

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

/// As hex, and as far as it can be read: the thesis's command (two int16), text.
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

}  // namespace

Json to_json(const TraceEvent& event) {
  Json out{{"at", to_iso8601_us(event.at)}, {"event", to_string(event.kind)}};
  add_text(out, "robot", event.robot);
  if (event.mesh) out["mesh"] = to_string(*event.mesh);
  add_text(out, "address", event.address);
  add_text(out, "topic", event.topic);
  add_text(out, "type", event.type);
  out["direction"] = event.direction == Direction::up ? "up" : "down";
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

Json lost_json(std::uint64_t count, WallTime at) {
  return {{"at", to_iso8601_us(at)}, {"event", "lost"}, {"lost", count}};
}

}  // namespace slamgw::control
