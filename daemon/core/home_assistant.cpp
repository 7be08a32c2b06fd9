// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/home_assistant.hpp"

#include <fmt/format.h>

#include <initializer_list>
#include <nlohmann/json.hpp>

// The rules are Home Assistant's: "MQTT device discovery payload" and "Discovery topic" in
// https://www.home-assistant.io/integrations/mqtt/. It ignores a document with an unknown key.
namespace slamgw {
namespace {

using Json = nlohmann::ordered_json;

/// Renders `online` or `offline` from a `state` or a presence. A sleeping robot counts as online.
/// The presence of a robot that has moved to another gateway is empty.
constexpr std::string_view is_there =
    "{{ 'offline' if (value_json | default({})).state | default('offline') == 'offline' "
    "else 'online' }}";
constexpr std::string_view signal = "{{ (value_json | default({})).rssi_dbm | default(none) }}";

/// One level of a discovery topic: letters, digits, `_` and `-`. `_` becomes `__`, any other octet
/// `_` and two hex digits.
std::string discovery_level(std::string_view text) {
  std::string level;
  for (const char c : text) {
    const bool is_plain =
        (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '-';
    if (is_plain)
      level += c;
    else
      level += c == '_' ? "__" : fmt::format("_{:02x}", static_cast<unsigned char>(c));
  }
  return level;
}

Json availability(std::initializer_list<std::string> topics) {
  Json all = Json::array();
  for (const std::string& topic : topics)
    all.push_back({{"topic", topic}, {"value_template", is_there}});
  return all;
}

/// `update` as bytes begins with both coordinates, little-endian. An empty one, which clears a
/// retained one, has none; Home Assistant would log an error.
Json coordinate(std::string name, std::string update_topic, UpdateMode mode) {
  const bool is_x = name == "X";
  Json sensor{{"platform", "sensor"},
              {"name", std::move(name)},
              {"state_topic", std::move(update_topic)},
              {"unit_of_measurement", "cm"},
              {"state_class", "measurement"}};
  if (mode == UpdateMode::json) {
    sensor["value_template"] = is_x ? "{{ (value_json | default({})).x | default(none) }}"
                                    : "{{ (value_json | default({})).y | default(none) }}";
  } else {
    sensor["value_template"] =
        is_x ? "{{ value | unpack('<h', 0) if value | length > 3 else none }}"
             : "{{ value | unpack('<h', 2) if value | length > 3 else none }}";
    sensor["encoding"] = "";
  }
  return sensor;
}

Json signal_strength(std::string presence_topic) {
  return {{"platform", "sensor"},
          {"name", "Signal"},
          {"device_class", "signal_strength"},
          {"entity_category", "diagnostic"},
          {"state_topic", std::move(presence_topic)},
          {"value_template", signal},
          {"unit_of_measurement", "dBm"}};
}

Json run_button(std::string name, std::string command_topic, std::string payload) {
  return {{"platform", "button"},
          {"name", std::move(name)},
          {"command_topic", std::move(command_topic)},
          {"payload_press", std::move(payload)},
          {"qos", 1}};
}

}  // namespace

std::string home_assistant_topic(const TopicScheme& topics, std::string_view robot) {
  return fmt::format("homeassistant/device/{}/{}/config", discovery_level(topics.prefix()),
                     discovery_level(robot));
}

std::string home_assistant_document(const TopicScheme& topics, std::string_view robot,
                                    UpdateMode update_mode, bool has_signal) {
  const std::string presence = topics.presence_topic(robot);
  const std::string update = topics.robot_topic(robot, "update");
  const std::string run = topics.command_topic(robot, "run");
  Json entities{{"presence",
                 {{"platform", "binary_sensor"},
                  {"name", "Presence"},
                  {"device_class", "connectivity"},
                  {"availability", availability({topics.state_topic()})},
                  {"state_topic", presence},
                  {"value_template", is_there},
                  {"payload_on", "online"},
                  {"payload_off", "offline"}}},
                {"x", coordinate("X", update, update_mode)},
                {"y", coordinate("Y", update, update_mode)},
                {"start", run_button("Start", run, "start")},
                {"stop", run_button("Stop", run, "stop")}};
  if (has_signal) entities["signal"] = signal_strength(presence);
  const std::string id = topics.robot_root() + std::string(robot);
  for (auto entity = entities.begin(); entity != entities.end(); ++entity)
    entity.value()["unique_id"] = id + "/" + entity.key();
  return Json{{"device", {{"identifiers", Json::array({id})}, {"name", robot}}},
              {"origin", {{"name", "slam-gateway"}}},
              {"availability", availability({topics.state_topic(), presence})},
              {"availability_mode", "all"},
              {"components", std::move(entities)}}
      .dump();
}

}  // namespace slamgw
