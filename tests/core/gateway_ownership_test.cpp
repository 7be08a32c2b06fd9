// SPDX-License-Identifier: Apache-2.0
// What the core does for a gateway that shares its broker with others (OwnershipQuery).
#include <gtest/gtest.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "tests/core/gateway_rig.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;

class GatewayOwnershipTest : public test::GatewayRig {};

TEST_F(GatewayOwnershipTest, KeepsRobotsSubscriptionsAwayFromABrokerThatSendsAllCommandsAnyway) {
  const std::string all = "ntnu-slam/server/+/+";
  const std::string of_r1 = "ntnu-slam/server/r1/+";
  bool hears_all = false;
  OwnershipQuery ownership;
  ownership.hears_all_commands = [&] { return hears_all; };
  gateway.share_with(ownership);
  broker_comes();
  say(SubscribeRequest{Mesh::thread, of_r1, Qos::at_least_once});
  EXPECT_EQ(drain<SubscribeAtBroker>().size(), 1u);

  hears_all = true;
  gateway.subscribe_own(all);
  EXPECT_EQ(drain<UnsubscribeAtBroker>().size(), 1u) << "r1's";
  say(SubscribeRequest{Mesh::thread, "ntnu-slam/server/r2/cmd", Qos::at_least_once});
  const auto answers = drain<AnswerSubscribe>();
  ASSERT_EQ(answers.size(), 1u);
  EXPECT_TRUE(answers[0].granted);
  broker_is(true);
  const auto again = drain<SubscribeAtBroker>();
  EXPECT_TRUE(std::ranges::none_of(
      again, [](const auto& each) { return each.filter.starts_with("ntnu-slam/server/r"); }));

  hears_all = false;
  gateway.unsubscribe_own(all);
  EXPECT_EQ(drain<SubscribeAtBroker>().size(), 2u) << "those of r1 and r2";
}

TEST_F(GatewayOwnershipTest, KeepsRobotsSubscriptionsWhereTheBrokerRefusesToSendAllCommands) {
  const std::string all = "ntnu-slam/server/+/+";
  OwnershipQuery ownership;
  ownership.hears_all_commands = [] { return true; };
  gateway.share_with(ownership);
  broker_comes();
  say(SubscribeRequest{Mesh::thread, "ntnu-slam/server/r1/+", Qos::at_least_once});
  gateway.subscribe_own(all);
  EXPECT_EQ(drain<SubscribeAtBroker>().size(), 1u) << "that to all";
  gateway.on_subscribe_result(all, SubscribeAnswer::granted, now);
  broker_is(true);  // another broker of the list
  drain<SubscribeAtBroker>();
  gateway.on_subscribe_result(all, SubscribeAnswer::refused, now);
  const auto again = drain<SubscribeAtBroker>();
  ASSERT_EQ(again.size(), 1u);
  EXPECT_EQ(again[0].filter, "ntnu-slam/server/r1/+");
}

TEST_F(GatewayOwnershipTest, KeepsTheFleetsSubscriptionWhenARobotLeavesTheSame) {
  const std::string filter = "ntnu-slam/gateway/+/state";
  broker_comes();
  gateway.subscribe_own(filter);
  say(SubscribeRequest{Mesh::thread, filter, Qos::at_least_once});
  EXPECT_EQ(drain<SubscribeAtBroker>().size(), 2u);
  say(UnsubscribeRequest{Mesh::thread, filter});
  EXPECT_TRUE(drain<UnsubscribeAtBroker>().empty());
  gateway.unsubscribe_own(filter);
  EXPECT_EQ(drain<UnsubscribeAtBroker>().size(), 1u);
  gateway.unsubscribe_own(filter);
  EXPECT_EQ(drain<UnsubscribeAtBroker>().size(), 1u) << "a former process may have left it";
}

TEST_F(GatewayOwnershipTest, GivesRobotsWhatTheFleetReadsTooButNotWhatIsBetweenGateways) {
  std::vector<std::string> shown;
  OwnershipQuery ownership;
  ownership.takes = [&](const BrokerMessage& message) {
    shown.push_back(message.topic);
    return message.topic.starts_with("ntnu-slam/fleet/");
  };
  gateway.share_with(ownership);
  broker_comes();
  for (const char* topic : {"ntnu-slam/gateway/b/state", "ntnu-slam/fleet/all/b"})
    gateway.on_broker_message({topic, to_bytes("{}"), Qos::at_least_once, false}, {}, now);
  EXPECT_EQ(shown.size(), 2u);
  const auto delivered = drain<DeliverToMeshes>();
  ASSERT_EQ(delivered.size(), 1u);
  EXPECT_EQ(delivered[0].message.topic, "ntnu-slam/gateway/b/state");
}

TEST_F(GatewayOwnershipTest, AnnouncesARobotThatItMayHaveLostWhenItIsItsOwn) {
  bool is_joining = true;
  OwnershipQuery ownership;
  ownership.may_announce = [&](const std::string&, Presence presence, bool has_just_come) {
    return !is_joining || presence == Presence::offline || has_just_come;
  };
  gateway.share_with(ownership);
  for (const char* robot : {"here", "lost"})
    say(PresenceChange{Mesh::thread, robot, Presence::online, "a"});
  say(PresenceChange{Mesh::thread, "lost", Presence::offline, "a"});
  const auto announced = [&] {
    std::vector<std::string> robots;
    for (const auto& upload : drain<Upload>()) {
      const std::string& topic = upload.message.topic;
      if (topic.find("/robots/") != std::string::npos)
        robots.push_back(topic.substr(topic.rfind('/') + 1));
    }
    return robots;
  };
  broker_is(true);
  EXPECT_EQ(announced(), std::vector<std::string>{"lost"}) << "is offline in any case";
  say(PresenceChange{Mesh::thread, "new", Presence::online, "b"});
  EXPECT_EQ(announced(), std::vector<std::string>{"new"});
  is_joining = false;
  gateway.on_taken_over("here", {}, now);
  EXPECT_EQ(announced(), std::vector<std::string>{"here"});
}

}  // namespace
}  // namespace slamgw
