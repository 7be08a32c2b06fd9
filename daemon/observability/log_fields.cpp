// SPDX-License-Identifier: Apache-2.0
#include "daemon/observability/log_fields.hpp"

#include <fmt/format.h>

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

std::string_view message_id_of(Occasion occasion) {
  switch (occasion) {
    case Occasion::other:
    case Occasion::broker_refusal: break;
    case Occasion::robot_message: return "484a36d2a3e146a38d044d92fa5db048";
    case Occasion::robot_presence: return "5c715c34f25146bca3f57ad82eb02071";
    case Occasion::command_outcome: return "3e090f5168f446d1bdd92c7835c03661";
    case Occasion::rejected_payload: return "7214773655d5405f9a3a199f9f4eed84";
    case Occasion::mesh_link: return "739ebd30b45a406d84eaa88ab8934b1d";
    case Occasion::broker_link: return "550c4beac3d44859aa03e13be098109c";
  }
  return {};
}

LogFields notice_fields(const Notice& notice) {
  LogFields fields;
  if (const std::string_view id = message_id_of(notice.occasion); !id.empty())
    fields.push_back({"MESSAGE_ID", std::string(id)});
  if (!notice.robot.empty()) fields.push_back({"ROBOT_ID", notice.robot});
  if (notice.mesh) fields.push_back({"MESH", std::string(to_string(*notice.mesh))});
  if (!notice.type.empty()) {
    const bool is_down = notice.occasion == Occasion::command_outcome;
    fields.push_back({"MESSAGE_TYPE", notice.type});
    fields.push_back({"DIRECTION", is_down ? "down" : "up"});
  }
  if (const auto& audit = notice.audit) {
    fields.push_back({"SLAM_AUDIT", "1"});
    fields.push_back({"SLAM_AUDIT_WHO", audit->who});
    fields.push_back({"SLAM_AUDIT_WHAT", audit->what});
    fields.push_back({"SLAM_AUDIT_OUTCOME", audit->outcome});
  }
  if (notice.latency) fields.push_back({"LATENCY_US", std::to_string(notice.latency->count())});
  return fields;
}

std::string traffic_text(const TrafficEvent& event, const TrafficLine& line) {
  const std::string what =
      event.robot.empty() ? "- " + event.topic : event.robot + " " + event.type;
  std::string text = fmt::format("{}{} {} {}", event.direction == Direction::down ? "to " : "",
                                 mesh_name(event), what, content(event));
  if (line.of_stream > 1) text += fmt::format(" ({} messages)", line.of_stream);
  if (line.of_others > 0)
    text += fmt::format(" (and {} more of any robot: too many to log)", line.of_others);
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
