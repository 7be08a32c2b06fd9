// SPDX-License-Identifier: Apache-2.0
// A forgotten robot leaves the broker, too. Also the gateway's own rights there.
#include <gtest/gtest.h>

#include <map>
#include <set>

#include "daemon/core/gateway.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;

class GatewayForget : public testing::Test {
 protected:
  void presence(const std::string& robot, Presence is) {
    gateway.on_mesh_event(PresenceChange{Mesh::thread, robot, is, "a"}, now);
    drain();
  }
  void broker_is(bool is_up) {
    broker.is_up = is_up;
    gateway.on_broker_link(now);
    drain();
  }
  void pass(Duration time) {
    now.mono += time;
    gateway.on_deadline(now);
    drain();
  }
  /// Plays the broker: keeps retained messages, and returns messages that the gateway may read.
  void drain() {
    while (auto action = gateway.next_action()) {
      if (const auto* upload = std::get_if<Upload>(&*action)) receive(upload->message);
      if (const auto* subscribe = std::get_if<SubscribeAtBroker>(&*action))
        gateway.on_subscribe_result(subscribe->filter, true, now);
      if (const auto* notice = std::get_if<Notice>(&*action)) notices.push_back(notice->text);
      if (const auto* gone = std::get_if<RobotForgotten>(&*action)) forgotten.insert(gone->robot);
    }
  }
  void receive(const BrokerMessage& message) {
    const std::string text(as_text(message.payload));
    if (message.retain && text.empty()) retained.erase(message.topic);
    if (message.retain && !text.empty()) retained[message.topic] = text;
    const bool is_probe = message.topic.ends_with("/probe");
    if (is_probe) probed.insert(message.topic);
    if (is_probe && (may_read_commands || !message.topic.starts_with("p/server/")))
      gateway.on_broker_message(message, now);
  }
  bool is_retained(const std::string& robot) const {
    return retained.contains("p/gateway/g/robots/" + robot);
  }

  Now now{TimePoint{1h}, WallTime{1'700'000'000s}};
  BrokerLink broker{true, {}, {}};
  Gateway gateway{TopicScheme("p", "g"), {.version = "1"}, broker, [](Mesh, const std::string&) {
                    return Presence::online;
                  }};
  bool may_read_commands = true;
  std::map<std::string, std::string> retained;
  std::vector<std::string> notices;
  std::set<std::string> probed;     ///< topics of the gateway's test messages
  std::set<std::string> forgotten;  ///< reported to the fleet
};

TEST_F(GatewayForget, RemovesARobotFromTheBroker) {
  presence("r", Presence::online);
  EXPECT_NE(gateway.forget("r"), "") << "it is online";
  presence("r", Presence::offline);
  EXPECT_TRUE(is_retained("r"));
  EXPECT_EQ(gateway.forget("r"), "");
  drain();
  EXPECT_FALSE(is_retained("r"));
  EXPECT_FALSE(gateway.registry().find("r"));
  EXPECT_NE(gateway.forget("a/b"), "");
}

TEST_F(GatewayForget, RemovesARobotOfAnEarlierRunFromTheBroker) {
  retained["p/gateway/g/robots/old"] = "{}";
  EXPECT_EQ(gateway.forget("old"), "");
  drain();
  EXPECT_FALSE(is_retained("old"));
}

TEST_F(GatewayForget, DoesNotShowAForgottenRobotOfAnEarlierRunAgain) {
  broker_is(true);
  retained["p/gateway/g/robots/old"] = R"({"state":"online"})";
  gateway.on_broker_message({"p/gateway/g/robots/old", to_bytes(R"({"state":"online"})"),
                             Qos::at_least_once, /*retain=*/true},
                            now);
  EXPECT_EQ(gateway.forget("old"), "");
  pass(PresencePublisher::leftover_grace);
  EXPECT_FALSE(is_retained("old"));
}

/// The broker sends retained messages before the ones that clear them.
TEST_F(GatewayForget, DoesNotShowARobotThatWasForgottenBeforeTheBrokerWasUp) {
  broker_is(false);
  EXPECT_EQ(gateway.forget("old"), "");
  broker_is(true);
  const std::string topic = "p/gateway/g/robots/old";
  for (const char* const text : {R"({"state":"online"})", ""})
    gateway.on_broker_message({topic, to_bytes(text), Qos::at_least_once, *text != '\0'}, now);
  pass(PresencePublisher::leftover_grace);
  EXPECT_FALSE(is_retained("old"));
}

TEST_F(GatewayForget, ClearsRetainedPresenceWhenTheBrokerIsBack) {
  presence("r", Presence::offline);
  presence("back", Presence::offline);
  broker_is(false);
  EXPECT_EQ(gateway.forget("r"), "");
  EXPECT_EQ(gateway.forget("back"), "");
  drain();
  EXPECT_TRUE(is_retained("r"));
  presence("back", Presence::online);
  broker_is(true);
  EXPECT_FALSE(is_retained("r"));
  EXPECT_TRUE(is_retained("back"));
}

TEST_F(GatewayForget, WithdrawsAbsentRobotsThatLeaveTheConfiguration) {
  gateway.on_configured({"gone", "here", "kept"});
  presence("gone", Presence::offline);
  presence("here", Presence::online);
  presence("kept", Presence::offline);
  gateway.on_configured({"kept"});
  drain();
  EXPECT_FALSE(is_retained("gone"));
  EXPECT_TRUE(is_retained("here")) << "it is online under another name, or as a stranger";
  EXPECT_TRUE(is_retained("kept"));
}

TEST_F(GatewayForget, ReportsRobotsThatAnOperatorForgetsToTheFleet) {
  presence("r", Presence::online);
  EXPECT_NE(gateway.forget("r"), "");
  drain();
  EXPECT_TRUE(forgotten.empty());
  presence("r", Presence::offline);
  EXPECT_EQ(gateway.forget("r"), "");
  drain();
  EXPECT_EQ(forgotten, std::set<std::string>{"r"});
}

TEST_F(GatewayForget, ReportsEvictedRobotsToTheFleet) {
  for (std::size_t i = 0; i <= RobotRegistry::max_robots; ++i)
    presence("r" + std::to_string(i), Presence::online);
  EXPECT_EQ(forgotten.size(), RobotRegistry::evicted_at_once);
  for (const std::string& robot : forgotten) EXPECT_FALSE(gateway.registry().find(robot));
}

/// The other gateway serves it then.
TEST_F(GatewayForget, ReportsNoGivenUpRobotToTheFleet) {
  presence("r", Presence::online);
  gateway.presence().on_given_up("r");
  drain();
  EXPECT_TRUE(forgotten.empty());
}

TEST_F(GatewayForget, ReportsNoMissingRightWhereItHasAll) {
  broker_is(true);
  EXPECT_EQ(probed, (std::set<std::string>{"p/gateway/g/probe", "p/server/g/probe"}));
  pass(11s);
  EXPECT_TRUE(gateway.missing_rights().empty());
  EXPECT_TRUE(notices.empty());
}

TEST_F(GatewayForget, ReportsAMissingRightAndWhenItIsGranted) {
  may_read_commands = false;
  broker_is(true);
  EXPECT_TRUE(gateway.missing_rights().empty()) << "the probe may be on its way";
  ASSERT_TRUE(gateway.deadline());
  pass(11s);
  ASSERT_EQ(gateway.missing_rights().size(), 1u);
  EXPECT_NE(gateway.missing_rights()[0].grant.find("topic read p/server/#"), std::string::npos);
  ASSERT_EQ(notices.size(), 1u);
  may_read_commands = true;
  pass(61s);
  EXPECT_TRUE(gateway.missing_rights().empty());
  EXPECT_EQ(notices.size(), 2u);
}

TEST_F(GatewayForget, ForgetsAnAbsentRobotThatItsMeshEvicted) {
  broker_is(true);
  const auto evict = [&] {
    gateway.on_mesh_event(SessionEvicted{Mesh::thread, "r"}, now);
    drain();
  };
  presence("r", Presence::online);
  evict();
  EXPECT_TRUE(is_retained("r")) << "it is online over another mesh";
  presence("r", Presence::offline);
  evict();
  EXPECT_FALSE(is_retained("r"));
  EXPECT_TRUE(forgotten.contains("r"));
}

}  // namespace
}  // namespace slamgw
