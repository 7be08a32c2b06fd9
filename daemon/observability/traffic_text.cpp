// SPDX-License-Identifier: Apache-2.0
#include "daemon/observability/traffic_text.hpp"

#include <fmt/format.h>

#include "daemon/observability/notice_fields.hpp"

namespace slamgw {
namespace {

std::string_view mesh_name(const TrafficEvent& event) {
  return event.mesh ? to_string(*event.mesh) : "-";
}

std::string content(const TrafficEvent& event) {
  if (!event.update) return fmt::format("{} bytes", event.payload.size());
  return fmt::format("x={} y={} obstacles={}", event.update->robot.x_cm, event.update->robot.y_cm,
                     event.update->obstacles.size());
}

}  // namespace

std::string traffic_text(const TrafficEvent& event, const TrafficLine& line) {
  std::string text = fmt::format("{}{} {} {} {}", event.direction == Direction::down ? "to " : "",
                                 mesh_name(event), event.robot, event.type, content(event));
  if (line.of_stream > 1) text += fmt::format(" ({} messages)", line.of_stream);
  if (line.of_others > 0)
    text += fmt::format(" (and {} of any robot: too many for lines of their own)", line.of_others);
  return text;
}

LogFields traffic_fields(const TrafficEvent& event) {
  LogFields fields{{"MESSAGE_ID", std::string(message_id_of(Occasion::robot_message))},
                   {"ROBOT_ID", event.robot},
                   {"MESSAGE_TYPE", event.type},
                   {"TOPIC", event.topic},
                   {"PAYLOAD_BYTES", std::to_string(event.payload.size())},
                   {"DIRECTION", event.direction == Direction::up ? "up" : "down"},
                   {"QOS", std::to_string(static_cast<int>(event.qos))}};
  if (event.mesh) fields.push_back({"MESH", std::string(to_string(*event.mesh))});
  if (event.update) {
    fields.push_back({"X_CM", std::to_string(event.update->robot.x_cm)});
    fields.push_back({"Y_CM", std::to_string(event.update->robot.y_cm)});
  }
  return fields;
}

}  // namespace slamgw
