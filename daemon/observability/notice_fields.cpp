// SPDX-License-Identifier: Apache-2.0
#include "daemon/observability/notice_fields.hpp"

namespace slamgw {

std::string_view message_id_of(Occasion occasion) {
  switch (occasion) {
    case Occasion::other: break;
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
  if (const auto& audit = notice.audit) {
    fields.push_back({"SLAM_AUDIT", "1"});
    fields.push_back({"SLAM_AUDIT_WHO", audit->who});
    fields.push_back({"SLAM_AUDIT_WHAT", audit->what});
    fields.push_back({"SLAM_AUDIT_OUTCOME", audit->outcome});
  }
  if (notice.latency) fields.push_back({"LATENCY_US", std::to_string(notice.latency->count())});
  return fields;
}

}  // namespace slamgw
