// SPDX-License-Identifier: Apache-2.0
// The severity of each event for operators: `journalctl -p warning` shows only lines that need
// attention.
#include <gtest/gtest.h>

#include "daemon/core/gateway.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;

struct Case {
  const char* name;
  MeshEvent event;
  Severity severity;
  Occasion occasion;
};

Report unreadable_update() {
  return {.mesh = Mesh::thread,
          .robot = "r",
          .topic = "ntnu-slam/robot/r/update",
          .payload = {1, 2, 3},
          .receipt = no_receipt};
}

CommandOutcome outcome(CommandResult result) {
  return {Mesh::thread, {}, "r", "cmd", result, 10ms, "why"};
}

std::ostream& operator<<(std::ostream& out, const Case& each) { return out << each.name; }

class Notices : public testing::TestWithParam<Case> {};

TEST_P(Notices, HaveTheSeverityAndOccasionOfTheirEvent) {
  const BrokerLink broker;
  Gateway gateway(TopicScheme("ntnu-slam", "g"), {"1", UpdateMode::positions, {}}, broker,
                  [](Mesh, const std::string&) { return std::nullopt; });
  gateway.on_mesh_event(GetParam().event, Now{TimePoint{1h}, {}});
  std::vector<Notice> notices;
  while (auto action = gateway.next_action())
    if (const auto* notice = std::get_if<Notice>(&*action)) notices.push_back(*notice);
  ASSERT_EQ(notices.size(), 1u);
  EXPECT_EQ(notices[0].severity, GetParam().severity) << notices[0].text;
  EXPECT_EQ(notices[0].occasion, GetParam().occasion) << notices[0].text;
  const bool has_robot = !notices[0].robot.empty();
  const bool has_type = has_robot && GetParam().occasion != Occasion::robot_presence;
  EXPECT_EQ(notices[0].mesh.has_value(), has_robot) << notices[0].text;
  EXPECT_EQ(!notices[0].type.empty(), has_type) << notices[0].text;
}

INSTANTIATE_TEST_SUITE_P(
    Of, Notices,
    testing::Values(
        Case{"LinkUp", LinkChange{Mesh::ble, true, "d"}, Severity::notice, Occasion::mesh_link},
        Case{"LinkDown", LinkChange{Mesh::ble, false, "d"}, Severity::warning, Occasion::mesh_link},
        Case{"RobotOnline", PresenceChange{Mesh::ble, "r", Presence::online, "a"}, Severity::info,
             Occasion::robot_presence},
        Case{"RobotDeaf", PresenceChange{Mesh::ble, "r", Presence::online, "a", true},
             Severity::warning, Occasion::robot_presence},
        Case{"RobotAsleep", PresenceChange{Mesh::thread, "r", Presence::asleep, "a"},
             Severity::info, Occasion::robot_presence},
        Case{"RobotOffline", PresenceChange{Mesh::ble, "r", Presence::offline, "a"}, Severity::info,
             Occasion::robot_presence},
        Case{"Delivered", outcome(CommandResult::delivered), Severity::info,
             Occasion::command_outcome},
        Case{"Sent", outcome(CommandResult::sent), Severity::info, Occasion::command_outcome},
        Case{"Timeout", outcome(CommandResult::timeout), Severity::warning,
             Occasion::command_outcome},
        Case{"Refused", outcome(CommandResult::refused), Severity::warning,
             Occasion::command_outcome},
        Case{"Superseded", outcome(CommandResult::superseded), Severity::info,
             Occasion::command_outcome},
        Case{"UnreadableUpdate", unreadable_update(), Severity::warning,
             Occasion::rejected_payload},
        Case{"NoticeOfAMesh", Notice{Severity::error, "text", {}}, Severity::error,
             Occasion::other}),
    [](const auto& each) { return each.param.name; });

TEST(Notice, WarnsOfASubscriptionThatTheBrokerRefuses) {
  const BrokerLink broker;
  Gateway gateway(TopicScheme("ntnu-slam", "g"), {"1", UpdateMode::positions, {}}, broker,
                  [](Mesh, const std::string&) { return std::nullopt; });
  gateway.on_subscribe_result("f", false, Now{});
  const auto action = gateway.next_action();
  ASSERT_TRUE(action && std::holds_alternative<Notice>(*action));
  EXPECT_EQ(std::get<Notice>(*action).severity, Severity::warning);
}

}  // namespace
}  // namespace slamgw
