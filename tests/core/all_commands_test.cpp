// SPDX-License-Identifier: Apache-2.0
// A robot's filter that wants fresh commands only, beside the subscription to all commands: the
// broker is not asked for it while that one stands, and each command is carried out once, always.
#include <gtest/gtest.h>

#include <algorithm>

#include "daemon/core/gateway.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;

class AllCommandsTest : public testing::Test {
 protected:
  AllCommandsTest() {
    link(true);
    steps.clear();  // the gateway's own subscriptions
  }

  void link(bool is_up) {
    broker.is_up = is_up;
    gateway.on_broker_link(now);
    drain();
  }
  void answer(const std::string& filter, SubscribeAnswer answer) {
    gateway.on_subscribe_result(filter, answer, now);
    drain();
  }
  void hear_all() {
    gateway.subscribe_own(all);
    drain();
    answer(all, SubscribeAnswer::granted);
    steps.clear();
  }
  void want(const std::string& filter, bool wants_retained, Qos qos = Qos::at_least_once) {
    gateway.on_mesh_event(SubscribeRequest{Mesh::thread, filter, qos, wants_retained}, now);
    drain();
  }
  /// One copy for each subscription that the broker has been asked for, as Mosquitto sends them.
  void server_sends(Qos qos = Qos::at_least_once) {
    for (const auto& [filter, id] : at_broker)
      if (filter == all || filter == of_a)
        gateway.on_broker_message({"ntnu-slam/server/a/cmd", {1}, qos, false}, std::vector{id},
                                  now);
    drain();
  }
  void drain() {
    while (auto action = gateway.next_action()) {
      if (auto* made = std::get_if<SubscribeAtBroker>(&*action)) {
        at_broker[made->filter] = made->id;
        qos_at_broker[made->filter] = made->qos;
        steps.push_back("+" + made->filter);
      } else if (auto* ended = std::get_if<UnsubscribeAtBroker>(&*action)) {
        at_broker.erase(ended->filter);
        steps.push_back("-" + ended->filter);
      } else if (auto* answered = std::get_if<AnswerSubscribe>(&*action)) {
        granted += answered->granted ? 1 : 0;
      } else if (const auto* command = std::get_if<DeliverToMeshes>(&*action)) {
        ++delivered;
        delivered_with = command->message.qos;
      }
    }
  }

  const std::string all = "ntnu-slam/server/+/+";
  const std::string of_a = "ntnu-slam/server/a/+";
  Now now{TimePoint{1h}, WallTime{1'700'000'000s}};
  BrokerLink broker;
  Gateway gateway{TopicScheme("ntnu-slam", "pi1"),
                  {"0.1.0", UpdateMode::positions, now.wall},
                  broker,
                  [](Mesh, const std::string&) { return std::optional(Presence::online); }};
  std::map<std::string, SubscriptionId> at_broker;
  std::map<std::string, Qos> qos_at_broker;
  std::vector<std::string> steps;
  int granted = 0;
  int delivered = 0;
  std::optional<Qos> delivered_with;
};

using Steps = std::vector<std::string>;

TEST_F(AllCommandsTest, AreEnoughForAFilterOfFreshCommands) {
  hear_all();
  want(of_a, false);
  EXPECT_EQ(steps, Steps{});
  EXPECT_EQ(granted, 1);
  server_sends();
  EXPECT_EQ(delivered, 1);
}

TEST_F(AllCommandsTest, AreNotEnoughForRetainedOnes) {
  hear_all();
  want(of_a, false);
  want(of_a, true);
  EXPECT_EQ(steps, Steps{"+" + of_a}) << "the robot subscribes to it itself";
  EXPECT_EQ(granted, 1) << "the broker answers that one";
  answer(of_a, SubscribeAnswer::granted);
  EXPECT_EQ(granted, 2);
  server_sends();
  EXPECT_EQ(delivered, 1);
  want("ntnu-slam/robot/b/update", false);
  EXPECT_EQ(steps.size(), 2u) << "no command";
}

TEST_F(AllCommandsTest, LeaveTheBrokerAfterTheRobotsOwnAreThere) {
  hear_all();
  want(of_a, false);
  gateway.unsubscribe_own(all);
  drain();
  EXPECT_EQ(steps, (Steps{"+" + of_a, "-" + all}));
  answer(of_a, SubscribeAnswer::granted);
  server_sends();
  EXPECT_EQ(delivered, 1);
}

TEST_F(AllCommandsTest, AreNotEnoughForAFilterOfMoreLevels) {
  hear_all();
  want("ntnu-slam/server/a/#", false);
  want("ntnu-slam/server/a/b/c", false);
  EXPECT_EQ(steps, (Steps{"+ntnu-slam/server/a/#", "+ntnu-slam/server/a/b/c"}));
}

/// On MQTT 3.1.1 beside another gateway, where they cover retained commands, too.
TEST_F(AllCommandsTest, AreNotEnoughForAFilterOfMoreLevelsBesideAnotherGateway) {
  OwnershipQuery ownership;
  ownership.hears_all_commands = [] { return true; };
  gateway.share_with(ownership);
  hear_all();
  want(of_a, true);
  want("ntnu-slam/server/a/#", false);
  want("ntnu-slam/server/a/b/c", false);
  EXPECT_EQ(steps, (Steps{"+ntnu-slam/server/a/#", "+ntnu-slam/server/a/b/c"}));
}

/// NATS does not bring all to who subscribes with QoS 1. With which QoS the server has sent them is
/// not known then, and a robot that does not acknowledge a command has missed it.
TEST_F(AllCommandsTest, GoToRobotsWithQos1WhereTheBrokerBringsThemWithQos0) {
  broker.keeps_session = false;
  link(true);
  hear_all();
  want(of_a, false);
  EXPECT_EQ(steps, Steps{}) << "they are enough for a filter of fresh commands";
  server_sends(Qos::at_most_once);
  EXPECT_EQ(delivered, 1);
  EXPECT_EQ(delivered_with, Qos::at_least_once);
}

/// Of a list of brokers, one may speak MQTT 5 and another one MQTT 3.1.1.
TEST_F(AllCommandsTest, AreAskedForWithTheQosThatSuitsEachBroker) {
  hear_all();
  EXPECT_EQ(qos_at_broker[all], Qos::at_least_once);
  broker.keeps_session = false;
  link(false);
  link(true);
  EXPECT_EQ(qos_at_broker[all], Qos::at_most_once);
  broker.keeps_session = true;
  link(false);
  link(true);
  EXPECT_EQ(qos_at_broker[all], Qos::at_least_once);
}

/// Such a broker names no subscription, and Mosquitto sends what comes with QoS 1 later while 20
/// are under way: then copies of one command are far apart, and would be taken for two.
TEST_F(AllCommandsTest, ComeWithOneQosForAllSubscriptionsWhereTheBrokerNamesNone) {
  broker.keeps_session = false;
  link(true);
  const std::string deep = "ntnu-slam/server/a/#";
  const std::string others = "ntnu-slam/robot/b/update";
  for (const auto& filter : {of_a, deep, others}) want(filter, true);
  EXPECT_EQ(qos_at_broker[of_a], Qos::at_least_once) << "the gateway does not hear all";
  hear_all();
  link(false);
  link(true);
  for (const auto& filter : {of_a, deep, all})
    EXPECT_EQ(qos_at_broker[filter], Qos::at_most_once) << filter;
  EXPECT_EQ(qos_at_broker[others], Qos::at_least_once);
  answer(all, SubscribeAnswer::refused);
  gateway.on_broker_message({"ntnu-slam/server/a/cmd", {1}, Qos::at_most_once, false}, {}, now);
  drain();
  EXPECT_EQ(delivered_with, Qos::at_least_once) << "also what their own filters bring";
}

/// A robot may listen to the commands of all, if the configuration says so.
TEST_F(AllCommandsTest, ThatOnlyARobotHearsWithQos0KeepTheirQosAndCoverNothing) {
  want(all, true, Qos::at_most_once);
  want(of_a, false);
  EXPECT_EQ(steps, (Steps{"+" + all, "+" + of_a}));
  gateway.on_broker_message({"ntnu-slam/server/a/cmd", {1}, Qos::at_most_once, false},
                            std::vector{at_broker.at(all)}, now);
  drain();
  EXPECT_EQ(delivered_with, Qos::at_most_once);
}

TEST_F(AllCommandsTest, KeepTheQosThatTheyHadElsewhere) {
  hear_all();
  server_sends(Qos::at_most_once);
  EXPECT_EQ(delivered_with, Qos::at_most_once);
}

TEST_F(AllCommandsTest, AreNotEnoughForQos2) {
  hear_all();
  want(of_a, false, Qos::exactly_once);
  EXPECT_EQ(steps, Steps{"+" + of_a});
}

TEST_F(AllCommandsTest, ThatTheBrokerRefusesCoverNothing) {
  hear_all();
  want(of_a, false);
  answer(all, SubscribeAnswer::refused);
  EXPECT_EQ(steps, Steps{"+" + of_a});
}

/// Where the broker names no subscription, copies could not be told while one of two ends.
TEST_F(AllCommandsTest, LeaveAFilterThatTheBrokerHasWhereItIs) {
  want(of_a, false);
  EXPECT_EQ(steps, Steps{"+" + of_a});
  hear_all();
  EXPECT_EQ(steps, Steps{});
  answer(of_a, SubscribeAnswer::granted);
  server_sends();
  EXPECT_EQ(delivered, 1);
}

TEST_F(AllCommandsTest, AreEnoughAfterAReconnect) {
  hear_all();
  want(of_a, false);
  link(false);
  at_broker.clear();
  link(true);
  EXPECT_EQ(std::ranges::count(steps, "+" + of_a), 0);
  EXPECT_EQ(std::ranges::count(steps, "+" + all), 1);
  answer(all, SubscribeAnswer::granted);
  server_sends();
  EXPECT_EQ(delivered, 1);
}

TEST_F(AllCommandsTest, ThatTheNextBrokerRefusesCoverNothing) {
  hear_all();
  want(of_a, false);
  link(false);
  at_broker.clear();
  link(true);
  answer(all, SubscribeAnswer::refused);
  EXPECT_EQ(std::ranges::count(steps, "+" + of_a), 1);
}

/// A daemon that is restarted has its robots' sessions before it has a broker, and a broker may
/// have kept the subscriptions of the process before.
class AllCommandsAtAStart : public testing::TestWithParam<bool> {};

TEST_P(AllCommandsAtAStart, AreAskedForAndRobotsOwnFiltersAreNot) {
  const bool keeps_session = GetParam();
  const Now now{TimePoint{1h}, WallTime{1'700'000'000s}};
  const std::string all = "ntnu-slam/server/+/+";
  const std::string of_a = "ntnu-slam/server/a/+";
  BrokerLink broker;
  Gateway gateway{TopicScheme("ntnu-slam", "pi1"),
                  {"0.1.0", UpdateMode::positions, now.wall},
                  broker,
                  [](Mesh, const std::string&) { return std::optional(Presence::online); }};
  gateway.subscribe_own(all);
  gateway.on_mesh_event(SubscribeRequest{Mesh::thread, of_a, Qos::at_least_once, false}, now);
  broker.is_up = true;
  broker.keeps_session = keeps_session;
  gateway.on_broker_link(now);
  const auto take_steps = [&] {
    std::vector<std::string> steps;
    while (auto action = gateway.next_action()) {
      if (const auto* made = std::get_if<SubscribeAtBroker>(&*action))
        if (made->filter == all || made->filter == of_a) steps.push_back("+" + made->filter);
      if (const auto* ended = std::get_if<UnsubscribeAtBroker>(&*action))
        steps.push_back("-" + ended->filter);
    }
    return steps;
  };
  EXPECT_EQ(take_steps(), Steps{"+" + all});
  gateway.on_subscribe_result(all, SubscribeAnswer::granted, now);
  EXPECT_EQ(take_steps(), keeps_session ? Steps{"-" + of_a} : Steps{})
      << "nothing is missed between the two";
}
INSTANTIATE_TEST_SUITE_P(Broker, AllCommandsAtAStart, testing::Bool());

/// It came while the gateway was away, when the broker had the subscription to all commands only.
TEST_F(AllCommandsTest, BringWhatTheBrokerHasKept) {
  for (const std::string robot : {"a", "robot-7", "robot-29", "sim-2"}) {
    const std::string filter = "ntnu-slam/server/" + robot + "/+";
    hear_all();
    link(false);
    link(true);
    answer(all, SubscribeAnswer::granted);
    want(filter, true);
    answer(filter, SubscribeAnswer::granted);
    delivered = 0;
    gateway.on_broker_message(
        {"ntnu-slam/server/" + robot + "/cmd", {1}, Qos::at_least_once, false},
        std::vector{at_broker.at(all)}, now);
    drain();
    EXPECT_EQ(delivered, 1) << robot;
  }
}

}  // namespace
}  // namespace slamgw
