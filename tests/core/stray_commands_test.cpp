// SPDX-License-Identifier: Apache-2.0
// Commands for unknown robots, at the gateway that receives all commands.
#include "daemon/core/command_ledger.hpp"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "tests/core/gateway_rig.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;
using nlohmann::json;

class StrayCommandsTest : public test::SharedGatewayRig {
 protected:
  void SetUp() override {
    SharedGatewayRig::SetUp();
    gateway.hear_all_commands(true);
    broker_is(true);
    wait(PresencePublisher::settling);
  }
  void server_sends(const std::string& robot, const std::string& text = "x",
                    const std::string& type = "cmd", bool retain = false) {
    gateway.on_broker_message(
        {"ntnu-slam/server/" + robot + "/" + type, to_bytes(text), Qos::at_most_once, retain}, now);
    take_actions();
  }
  void wait(Duration time) {
    pass(time);
    take_actions();
  }
  void take_actions() {
    while (auto action = gateway.next_action()) {
      if (auto* upload = std::get_if<Upload>(&*action);
          upload && upload->message.topic.find("/commands/") != std::string::npos)
        outcomes.emplace_back(upload->message.topic, json::parse(upload->message.payload));
      if (auto* delivery = std::get_if<DeliverToMesh>(&*action)) {
        delivered.emplace_back(as_text(delivery->message.message.payload));
        waited = delivery->message.message.waited;
      }
      if (auto* subscribe = std::get_if<SubscribeAtBroker>(&*action);
          subscribe && !test::is_of_rights_probe(*subscribe))
        filters.push_back(subscribe->filter);
      if (auto* unsubscribe = std::get_if<UnsubscribeAtBroker>(&*action))
        filters.push_back("-" + unsubscribe->filter);
      if (auto* notice = std::get_if<Notice>(&*action))
        lines += notice->occasion == Occasion::command_outcome ? 1 : 0;
    }
  }

  std::vector<std::pair<std::string, json>> outcomes;
  std::vector<std::string> delivered;
  std::vector<std::string> filters;
  Duration waited{};  ///< of the last one that was delivered
  int lines = 0;
};

TEST_F(StrayCommandsTest, AreRefusedAfterPatienceWhenTheRobotIsStillUnknown) {
  server_sends("stranger");
  EXPECT_TRUE(outcomes.empty());
  ASSERT_EQ(gateway.deadline(), now.mono + StrayCommands::patience);
  wait(StrayCommands::patience - 1ms);
  EXPECT_TRUE(outcomes.empty());
  wait(1ms);
  ASSERT_EQ(outcomes.size(), 1u);
  EXPECT_EQ(outcomes[0].first, "ntnu-slam/gateway/pi1/commands/stranger");
  EXPECT_EQ(outcomes[0].second["outcome"], "refused");
  EXPECT_EQ(outcomes[0].second["type"], "cmd");
  EXPECT_EQ(outcomes[0].second["after_ms"], 500);
  EXPECT_EQ(outcomes[0].second["why"], "no robot of this name is known here");
  EXPECT_TRUE(delivered.empty());
  wait(1min);
  EXPECT_EQ(outcomes.size(), 1u);
}

TEST_F(StrayCommandsTest, AreRefusedWhenTheBrokerRefusesTheRobotsSession) {
  say(PresenceChange{Mesh::thread, "r1", Presence::online, "a"});
  refused.insert("r1");
  server_sends("r1");
  wait(StrayCommands::patience);
  ASSERT_EQ(outcomes.size(), 1u);
  EXPECT_EQ(outcomes[0].second["why"],
            "the broker does not give the robot's session to this gateway");
}

TEST_F(StrayCommandsTest, WaitUntilTheOtherGatewaysRobotsAreKnown) {
  broker_is(false);
  broker_is(true);
  const TimePoint back = now.mono;
  server_sends("stranger");
  server_sends("theirs");
  EXPECT_EQ(gateway.deadline(), back + PresencePublisher::settling);
  wait(StrayCommands::patience);
  EXPECT_TRUE(outcomes.empty());
  elsewhere.insert("theirs");
  wait(back + PresencePublisher::settling - now.mono - 1ms);
  EXPECT_TRUE(outcomes.empty());
  wait(1ms);
  ASSERT_EQ(outcomes.size(), 1u);
  EXPECT_EQ(outcomes[0].first, "ntnu-slam/gateway/pi1/commands/stranger");
  EXPECT_EQ(outcomes[0].second["after_ms"], 6000);
}

TEST_F(StrayCommandsTest, WaitThroughAShortLossOfTheBroker) {
  server_sends("stranger");
  broker_is(false);
  EXPECT_EQ(gateway.deadline(), now.mono + StrayCommands::longest);
  wait(1s);
  EXPECT_TRUE(outcomes.empty());
  broker.is_up = true;  // not yet reported to the core
  EXPECT_GT(gateway.deadline(), now.mono);
  gateway.on_deadline(now);
  EXPECT_TRUE(outcomes.empty());
  gateway.on_broker_link(now);
  wait(PresencePublisher::settling);
  EXPECT_EQ(outcomes.size(), 1u);
}

TEST_F(StrayCommandsTest, HaveAnOutcomeInTimeWhileTheBrokerComesAndGoes) {
  server_sends("stranger");
  const TimePoint latest = now.mono + StrayCommands::longest;
  while (latest - now.mono > PresencePublisher::settling) {
    broker_is(false);
    broker_is(true);
    wait(PresencePublisher::settling - 1ms);
    EXPECT_TRUE(outcomes.empty());
  }
  broker_is(false);
  EXPECT_EQ(gateway.deadline(), latest);
  wait(latest - now.mono);
  ASSERT_EQ(outcomes.size(), 1u);
  EXPECT_EQ(outcomes[0].second["after_ms"], StrayCommands::longest.count());
}

TEST_F(StrayCommandsTest, AreLeftToTheSessionsOfRobotsThatAGatewayServes) {
  held.insert("held");
  elsewhere.insert("theirs");
  left.insert("orphan");
  for (const char* robot : {"held", "theirs", "orphan"}) server_sends(robot);
  EXPECT_TRUE(delivered.empty()) << "the robot's session brings it";
  wait(1min);
  EXPECT_TRUE(outcomes.empty());
}

TEST_F(StrayCommandsTest, AreDroppedWhenTheRobotsSessionOrAnotherGatewayHasThem) {
  for (const char* robot : {"here", "held", "theirs"}) server_sends(robot);
  say(PresenceChange{Mesh::thread, "here", Presence::online, "a"});
  session_comes("held", /*was_present=*/true);
  elsewhere.insert("theirs");
  wait(StrayCommands::patience);
  session_comes("here", /*was_present=*/true);
  wait(1min);
  EXPECT_TRUE(delivered.empty());
  EXPECT_TRUE(outcomes.empty()) << "the holder of the session reports it";
}

TEST_F(StrayCommandsTest, ReachARobotInTheirOrderWhenItsNewSessionIsHeldSoon) {
  server_sends("late", "1");
  server_sends("other", "2");
  server_sends("late", "3");
  reach[{Mesh::thread, "late"}] = Presence::online;
  now.mono += 200ms;
  session_comes("late", /*was_present=*/false);
  take_actions();
  EXPECT_EQ(delivered, (std::vector<std::string>{"1", "3"}));
  EXPECT_EQ(waited, 200ms) << "its mesh has that much less time";
  EXPECT_EQ(gateway.commands().open(), 2u);
  wait(StrayCommands::patience);
  ASSERT_EQ(outcomes.size(), 1u);
  EXPECT_EQ(outcomes[0].first, "ntnu-slam/gateway/pi1/commands/other");
  EXPECT_EQ(delivered.size(), 2u);
}

TEST_F(StrayCommandsTest, AreRefusedWhenTheRobotsNewSessionHasNoSubscriptionToThem) {
  server_sends("late");
  reach[{Mesh::thread, "late"}] = Presence::online;
  unsubscribed.insert("late");
  now.mono += 200ms;
  session_comes("late", /*was_present=*/false);
  take_actions();
  EXPECT_TRUE(delivered.empty());
  ASSERT_EQ(outcomes.size(), 1u);
  EXPECT_EQ(outcomes[0].second["outcome"], "refused");
  EXPECT_EQ(outcomes[0].second["after_ms"], 200);
  EXPECT_EQ(outcomes[0].second["why"], "the robot has not subscribed to ntnu-slam/server/late/cmd");
}

TEST_F(StrayCommandsTest, ReachARobotWhoseNewSessionTakesSeconds) {
  say(PresenceChange{Mesh::thread, "slow", Presence::offline, "a"});
  server_sends("slow", "1");
  wait(20s);
  EXPECT_TRUE(outcomes.empty());
  reach[{Mesh::thread, "slow"}] = Presence::online;
  session_comes("slow", /*was_present=*/false);
  take_actions();
  EXPECT_EQ(delivered, std::vector<std::string>{"1"});
  EXPECT_EQ(waited, 20s);
}

TEST_F(StrayCommandsTest, AreRefusedInTimeWhenTheRobotsSessionNeverOpens) {
  say(PresenceChange{Mesh::thread, "slow", Presence::offline, "a"});
  server_sends("slow");
  wait(StrayCommands::longest);
  ASSERT_EQ(outcomes.size(), 1u);
  EXPECT_EQ(outcomes[0].second["outcome"], "refused");
  EXPECT_EQ(outcomes[0].second["after_ms"], StrayCommands::longest.count());
}

TEST_F(StrayCommandsTest, HaveNoOutcomeAtTheStopWhileTheRobotAwaitsItsSession) {
  say(PresenceChange{Mesh::thread, "slow", Presence::offline, "a"});
  server_sends("slow");
  gateway.on_stop(now);
  take_actions();
  EXPECT_TRUE(outcomes.empty()) << "its session may bring the command after the restart";
}

TEST_F(StrayCommandsTest, AreNotDeliveredAfterASortedSessionHasRefusedThem) {
  say(PresenceChange{Mesh::thread, "r1", Presence::online, "a"});
  server_sends("r1", "1");
  gateway.commands().on_session_sorted("r1");
  server_sends("r1", "2");
  reach[{Mesh::thread, "r1"}] = Presence::online;
  session_comes("r1", /*was_present=*/false);
  take_actions();
  EXPECT_EQ(delivered, std::vector<std::string>{"2"}) << "the broker has dropped the first one";
}

TEST_F(StrayCommandsTest, AreNeitherRetainedMessagesNorRightsProbes) {
  server_sends("stranger", "x", "cmd", /*retain=*/true);
  server_sends("room-b", "17-1", "probe");
  wait(1min);
  EXPECT_TRUE(outcomes.empty());
  server_sends("unknown", "x", "probe");
  wait(1min);
  EXPECT_EQ(outcomes.size(), 1u) << "a command whose type is probe";
}

TEST_F(StrayCommandsTest, AreReceivedWithASubscriptionThatCanBeEnded) {
  EXPECT_EQ(filters, std::vector<std::string>{"ntnu-slam/server/+/+"});
  gateway.hear_all_commands(true);
  take_actions();
  EXPECT_EQ(filters.size(), 1u);
  gateway.hear_all_commands(false);
  take_actions();
  EXPECT_EQ(filters.back(), "-ntnu-slam/server/+/+");
}

TEST_F(StrayCommandsTest, AreLeftToTheGatewayThatReceivesAllCommandsNow) {
  server_sends("stranger");
  gateway.hear_all_commands(false);
  wait(1min);
  gateway.on_stop(now);
  take_actions();
  EXPECT_TRUE(outcomes.empty());
}

TEST_F(StrayCommandsTest, HaveTheirOutcomesWhenTheGatewayStops) {
  server_sends("stranger");
  server_sends("another stranger");
  server_sends("theirs");
  elsewhere.insert("theirs");
  gateway.on_stop(now);
  take_actions();
  EXPECT_EQ(outcomes.size(), 2u);
}

TEST_F(StrayCommandsTest, ForManyInventedNamesAreBoundedAndLoggedOnce) {
  constexpr std::size_t crowd = StrayCommands::max_waiting + 100;
  for (std::size_t i = 0; i < crowd; ++i) server_sends(fmt::format("n{}", i));
  EXPECT_EQ(outcomes.size(), 100u) << "the oldest are refused at once";
  EXPECT_EQ(outcomes[0].first, "ntnu-slam/gateway/pi1/commands/n0");
  wait(StrayCommands::patience);
  EXPECT_EQ(outcomes.size(), crowd) << "each has its outcome";
  EXPECT_EQ(lines, 1);
  const std::string large(StrayCommands::max_octets / 2, 'x');
  for (int i = 0; i < 3; ++i) server_sends("large", large);
  EXPECT_EQ(outcomes.size(), crowd + 1);
}

/// Otherwise the session could bring a command that was already refused.
TEST_F(StrayCommandsTest, OfARobotThatAwaitsItsSessionOutlastManyInventedNames) {
  say(PresenceChange{Mesh::thread, "slow", Presence::offline, "a"});
  server_sends("slow");
  for (std::size_t i = 0; i < StrayCommands::max_waiting + 7; ++i)
    server_sends(fmt::format("n{}", i));
  EXPECT_EQ(outcomes.size(), 8u);
  for (const auto& [topic, outcome] : outcomes)
    EXPECT_NE(topic, "ntnu-slam/gateway/pi1/commands/slow");
}

TEST_F(StrayCommandsTest, AreBoundedWhileTheOtherGatewaysAreUnknown) {
  broker_is(false);
  broker_is(true);
  take_actions();
  for (std::size_t i = 0; i < StrayCommands::max_waiting + 7; ++i)
    server_sends(fmt::format("n{}", i));
  EXPECT_EQ(outcomes.size(), 7u);
}

}  // namespace
}  // namespace slamgw
