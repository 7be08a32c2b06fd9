// SPDX-License-Identifier: Apache-2.0
// Commands for robots that nobody knows, at a gateway that is alone and hears all commands.
#include "daemon/core/stray_commands.hpp"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <set>

#include "daemon/core/gateway.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;
using nlohmann::json;

class StrayCommandsTest : public testing::Test {
 protected:
  void SetUp() override {
    OwnershipQuery ownership;
    ownership.is_shared = [this] { return is_shared; };
    gateway.share_with(ownership);
    broker.is_up = true;
    gateway.on_broker_link(now);
    subscribe("ntnu-slam/server/+/+");
  }
  void subscribe(const std::string& filter) {
    gateway.on_mesh_event(SubscribeRequest{Mesh::thread, filter, Qos::at_least_once}, now);
    gateway.on_subscribe_result(filter, SubscribeAnswer::granted, now);
    drain();
  }
  void server_sends(const std::string& robot, const std::string& text = "x",
                    const std::string& type = "cmd") {
    gateway.on_broker_message(
        {"ntnu-slam/server/" + robot + "/" + type, to_bytes(text), Qos::at_least_once, false}, {},
        now);
    drain();
  }
  void pass(Duration time) {
    now.mono += time;
    gateway.on_deadline(now);
    drain();
  }
  void drain() {
    while (auto action = gateway.next_action()) {
      if (auto* upload = std::get_if<Upload>(&*action); upload && upload->outcome_after)
        outcomes.emplace_back(upload->message.topic, json::parse(upload->message.payload));
      if (auto* delivery = std::get_if<DeliverToMeshes>(&*action); delivery && delivery->carrier) {
        delivered.emplace_back(as_text(delivery->message.payload));
        waited = delivery->message.waited;
      }
      if (auto* await = std::get_if<AwaitTurn>(&*action)) {
        ++awaiting;
        waited = await->message.waited;
      }
      if (auto* notice = std::get_if<Notice>(&*action))
        lines += notice->occasion == Occasion::command_outcome ? 1 : 0;
    }
  }

  Now now{TimePoint{1h}, WallTime{1'700'000'000s}};
  bool is_shared = false;
  std::set<std::string> known;
  BrokerLink broker;
  Gateway gateway{TopicScheme("ntnu-slam", "pi1"),
                  {"0.1.0", UpdateMode::positions, now.wall},
                  broker,
                  [this](Mesh mesh, const std::string& robot) -> std::optional<Presence> {
                    if (mesh != Mesh::thread || !known.contains(robot)) return std::nullopt;
                    return Presence::online;
                  }};
  std::vector<std::pair<std::string, json>> outcomes;
  std::vector<std::string> delivered;
  int awaiting = 0;
  Duration waited{};  ///< the last one of both
  int lines = 0;
};

TEST_F(StrayCommandsTest, AreRefusedWhenNobodyIsKnownAMomentLater) {
  server_sends("nobody");
  EXPECT_TRUE(outcomes.empty());
  ASSERT_EQ(gateway.deadline(), now.mono + StrayCommands::patience);
  pass(StrayCommands::patience);
  ASSERT_EQ(outcomes.size(), 1u);
  EXPECT_EQ(outcomes[0].first, "ntnu-slam/gateway/pi1/commands/nobody");
  EXPECT_EQ(outcomes[0].second["outcome"], "refused");
  EXPECT_EQ(outcomes[0].second["type"], "cmd");
  EXPECT_EQ(outcomes[0].second["after_ms"], 500);
  EXPECT_EQ(outcomes[0].second["why"], "no robot of this name is known here");
  pass(1min);
  EXPECT_EQ(outcomes.size(), 1u);
}

TEST_F(StrayCommandsTest, ReachARobotThatIsKnownAMomentLaterInTheirOrder) {
  server_sends("late", "1");
  server_sends("late", "2");
  server_sends("other", "3");
  known.insert("late");
  server_sends("late", "4");
  EXPECT_EQ(delivered, (std::vector<std::string>{"1", "2", "4"}));
  server_sends("early", "5");
  known.insert("early");
  pass(StrayCommands::patience);
  EXPECT_EQ(delivered.back(), "5");
  EXPECT_EQ(waited, StrayCommands::patience) << "its mesh has that much less time";
  ASSERT_EQ(outcomes.size(), 1u);
  EXPECT_EQ(outcomes[0].first, "ntnu-slam/gateway/pi1/commands/other");
}

TEST_F(StrayCommandsTest, WhichOtherRobotsListenToGoToThemAtOnce) {
  subscribe("ntnu-slam/server/all/+");
  server_sends("all");
  ASSERT_EQ(outcomes.size(), 1u);
  EXPECT_EQ(outcomes[0].second["outcome"], "refused");
}

TEST_F(StrayCommandsTest, AreNeitherRetainedOnesNorGatewaysThatTryTheirRights) {
  gateway.on_broker_message(
      {"ntnu-slam/server/nobody/cmd", to_bytes("x"), Qos::at_least_once, true}, {}, now);
  server_sends("room-b", "17-1", "probe");
  pass(1min);
  EXPECT_TRUE(outcomes.empty());
}

TEST_F(StrayCommandsTest, EndWithTheGateway) {
  server_sends("nobody");
  gateway.on_stop(now);
  drain();
  EXPECT_EQ(outcomes.size(), 1u);
}

TEST_F(StrayCommandsTest, AreLeftToTheFleetWhenAnotherGatewayHasCome) {
  server_sends("roaming");
  is_shared = true;
  pass(StrayCommands::patience);
  EXPECT_EQ(awaiting, 1);
  EXPECT_EQ(waited, StrayCommands::patience);
  EXPECT_TRUE(outcomes.empty());
}

TEST_F(StrayCommandsTest, OfACrowdOfMadeUpNamesHaveABoundAndFewLines) {
  constexpr std::size_t crowd = StrayCommands::max_waiting + 100;
  for (std::size_t i = 0; i < crowd; ++i) server_sends(fmt::format("n{}", i));
  EXPECT_EQ(outcomes.size(), 100u) << "the oldest at once";
  EXPECT_EQ(outcomes[0].first, "ntnu-slam/gateway/pi1/commands/n0");
  pass(StrayCommands::patience);
  EXPECT_EQ(outcomes.size(), crowd) << "each has its outcome";
  EXPECT_EQ(lines, 1);
  const std::string large(StrayCommands::max_octets / 2, 'x');
  for (int i = 0; i < 3; ++i) server_sends("large", large);
  EXPECT_EQ(outcomes.size(), crowd + 1);
}

}  // namespace
}  // namespace slamgw
