// SPDX-License-Identifier: Apache-2.0
// Whoever sends a command gets the outcome of that command, whatever else is on its way to the same
// robot.
#include "daemon/app/pending_sends.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

#include "daemon/core/gateway.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;
using nlohmann::json;

/// The core and those who wait, as App joins them; the test is the mesh.
class PendingSendsTest : public testing::Test {
 protected:
  void server_sends(const std::string& topic) {
    gateway.on_broker_message({topic, {1, 2, 3, 4}, Qos::at_least_once, false}, {}, now);
    drain();
  }
  void operator_sends(const std::string& robot, const std::string& type) {
    const CommandId command = gateway.on_operator_command(robot, type, {5, 6, 7, 8}, now);
    sends.add(
        command, [this](const json& outcome) { told.push_back(outcome); }, now.mono);
    drain();
  }
  void mesh_ends(CommandId command, CommandResult result) {
    gateway.on_mesh_event(CommandOutcome{Mesh::thread, command, "r", "cmd", result, 5ms, ""}, now);
    drain();
  }
  void drain() {
    while (auto action = gateway.next_action()) {
      if (const auto* deliver = std::get_if<DeliverToMeshes>(&*action))
        delivered.push_back(deliver->command);
      if (const auto* outcome = std::get_if<CommandOutcome>(&*action)) sends.on_outcome(*outcome);
    }
  }

  Now now{TimePoint{1h}, {}};
  Gateway gateway{TopicScheme("p", "g"),
                  {"1", UpdateMode::positions, {}},
                  [](Mesh, const std::string&) { return Presence::online; }};
  PendingSends sends;
  std::vector<CommandId> delivered;
  std::vector<json> told;
};

TEST_F(PendingSendsTest, TellTheOutcomeOfTheirOwnCommandBesideOthersOfTheSameRobotAndType) {
  constexpr CommandResult fates[] = {CommandResult::refused, CommandResult::delivered,
                                     CommandResult::superseded};
  std::vector<int> order{0, 1, 2};
  do {  // in whatever order they end
    delivered.clear();
    told.clear();
    server_sends("p/server/r/cmd");
    operator_sends("r", "cmd");
    server_sends("p/server/r/cmd");
    ASSERT_EQ(delivered.size(), 3u);
    for (const int which : order)
      mesh_ends(delivered[static_cast<std::size_t>(which)], fates[which]);
    ASSERT_EQ(told.size(), 1u);
    EXPECT_EQ(told[0]["outcome"], "delivered");
  } while (std::next_permutation(order.begin(), order.end()));
}

TEST_F(PendingSendsTest, AreToldOnceAndNotAboutStrangers) {
  operator_sends("r", "cmd");
  mesh_ends(CommandId::none, CommandResult::delivered);  // from before a restart
  EXPECT_TRUE(told.empty());
  mesh_ends(delivered[0], CommandResult::timeout);
  mesh_ends(delivered[0], CommandResult::delivered);
  ASSERT_EQ(told.size(), 1u);
  EXPECT_EQ(told[0]["outcome"], "timeout");
}

TEST_F(PendingSendsTest, AreBounded) {
  for (std::size_t i = 0; i < PendingSends::max_waiting; ++i) operator_sends("r", "cmd");
  EXPECT_TRUE(sends.is_full());
  sends.on_time(now.mono + PendingSends::patience);
  EXPECT_FALSE(sends.is_full());
  EXPECT_EQ(told.size(), PendingSends::max_waiting);
}

}  // namespace
}  // namespace slamgw
