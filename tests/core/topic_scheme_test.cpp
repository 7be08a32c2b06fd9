// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/topic_scheme.hpp"

#include <gtest/gtest.h>

namespace slamgw {
namespace {

const TopicScheme scheme("ntnu-slam", "pi1");

TEST(TopicScheme, BuildsTheTopicsOfTheDocumentation) {
  EXPECT_EQ(scheme.robot_topic("NRF_5", "update"), "ntnu-slam/robot/NRF_5/update");
  EXPECT_EQ(scheme.command_topic("NRF_5", "cmd"), "ntnu-slam/server/NRF_5/cmd");
  EXPECT_EQ(scheme.command_filter("NRF_5"), "ntnu-slam/server/NRF_5/+");
  EXPECT_EQ(scheme.state_topic(), "ntnu-slam/gateway/pi1/state");
  EXPECT_EQ(scheme.stats_topic(), "ntnu-slam/gateway/pi1/stats");
  EXPECT_EQ(scheme.presence_topic("NRF_5"), "ntnu-slam/gateway/pi1/robots/NRF_5");
  EXPECT_EQ(scheme.outcome_topic("NRF_5"), "ntnu-slam/gateway/pi1/commands/NRF_5");
  EXPECT_EQ(scheme.rejected_topic("NRF_5", "update"),
            "ntnu-slam/gateway/pi1/rejected/NRF_5/update");
}

TEST(TopicScheme, ParsesBothDirectionsAndNothingElse) {
  const auto up = scheme.parse_robot_topic("ntnu-slam/robot/NRF_5/update");
  ASSERT_TRUE(up);
  EXPECT_EQ(up->robot, "NRF_5");
  EXPECT_EQ(up->type, "update");
  EXPECT_TRUE(scheme.parse_command_topic("ntnu-slam/server/NRF_5/cmd"));
  for (const char* other : {"ntnu-slam/robot/NRF_5", "ntnu-slam/robot/NRF_5/", "ntnu-slam/robot//x",
                            "ntnu-slam/robot/a/b/c", "ntnu-slam/robots/a/b", "x/robot/a/b",
                            "ntnu-slam/server/a/b", "ntnu-slam/robot/a/+", "", "/"}) {
    EXPECT_FALSE(scheme.parse_robot_topic(other)) << other;
  }
}

TEST(TopicScheme, BuildsTheTopicsOfOtherGateways) {
  EXPECT_EQ(scheme.presence_topic_at("pi2", "NRF_5"), "ntnu-slam/gateway/pi2/robots/NRF_5");
  EXPECT_EQ(scheme.presence_filter(), "ntnu-slam/gateway/+/robots/+");
  EXPECT_EQ(scheme.state_filter(), "ntnu-slam/gateway/+/state");
  EXPECT_EQ(scheme.hears_topic(), "ntnu-slam/fleet/all/pi1");
  EXPECT_EQ(scheme.hears_filter(), "ntnu-slam/fleet/all/+");
}

TEST(TopicScheme, ParsesThePresenceTopicOfEachGateway) {
  for (const std::string gateway : {"pi1", "pi2"}) {
    const std::string topic = scheme.presence_topic_at(gateway, "NRF_5");
    EXPECT_TRUE(filter_matches(scheme.presence_filter(), topic));
    const auto shown = scheme.parse_presence_topic(topic);
    ASSERT_TRUE(shown);
    EXPECT_EQ(shown->gateway, gateway);
    EXPECT_EQ(shown->robot, "NRF_5");
  }
  for (const char* other :
       {"ntnu-slam/gateway/pi2/robots", "ntnu-slam/gateway/pi2/robots/",
        "ntnu-slam/gateway/pi2/robots/a/b", "ntnu-slam/gateway//robots/a",
        "ntnu-slam/gateway/pi2/commands/a", "ntnu-slam/gateway/+/robots/a",
        "x/gateway/pi2/robots/a", "ntnu-slam/gateway/", "ntnu-slam/gateway/pi2", ""})
    EXPECT_FALSE(scheme.parse_presence_topic(other)) << other;
}

TEST(TopicScheme, FindsTheGatewayOfAStateTopic) {
  EXPECT_EQ(scheme.gateway_of_state("ntnu-slam/gateway/pi2/state"), "pi2");
  EXPECT_EQ(scheme.gateway_of_state(scheme.state_topic()), "pi1");
  for (const char* other :
       {"ntnu-slam/gateway/pi2/stats", "ntnu-slam/gateway/pi2/state/x", "ntnu-slam/gateway//state",
        "ntnu-slam/gateway/state", "ntnu-slam/gateway/pi2", "x/gateway/pi2/state", ""})
    EXPECT_FALSE(scheme.gateway_of_state(other)) << other;
}

TEST(TopicScheme, FindsTheGatewayOfAHearsTopic) {
  EXPECT_EQ(scheme.gateway_of_hears("ntnu-slam/fleet/all/pi2"), "pi2");
  EXPECT_EQ(scheme.gateway_of_hears(scheme.hears_topic()), "pi1");
  for (const char* other : {"ntnu-slam/fleet/all/", "ntnu-slam/fleet/all/a/b",
                            "ntnu-slam/fleet/robots/a", "ntnu-slam/fleet/all/+", ""})
    EXPECT_FALSE(scheme.gateway_of_hears(other)) << other;
}

TEST(TopicLevel, IsOneLevelOfAtMost64BytesOfText) {
  EXPECT_TRUE(is_valid_level("NRF_5"));
  EXPECT_TRUE(is_valid_level("r\xc3\xb8ver"));
  EXPECT_TRUE(is_valid_level(std::string(64, 'x')));
  for (const std::string& bad :
       {std::string(), std::string(65, 'x'), std::string("a/b"), std::string("a+"),
        std::string("#"), std::string("a\n"), std::string("a\0b", 3), std::string("\x7f"),
        std::string("\xff"), std::string("a\xc2\x85"), std::string("\xef\xbf\xbe")}) {
    EXPECT_FALSE(is_valid_level(bad)) << bad;
  }
}

TEST(TopicFilter, AllowsWildcardsOnlyWhereMqttDoes) {
  for (const char* good : {"a", "a/b", "+", "#", "a/+/b", "a/#", "+/+", "/", "a//b"}) {
    EXPECT_TRUE(is_valid_filter(good)) << good;
  }
  for (const char* bad : {"", "a+", "+a/b", "#/a", "a/#/b", "a#"}) {
    EXPECT_FALSE(is_valid_filter(bad)) << bad;
  }
  EXPECT_FALSE(is_valid_topic_name("a/+"));
  EXPECT_FALSE(is_valid_topic_name(std::string_view("a\0b", 3)));
}

TEST(TopicFilter, RefusesCharactersForWhichBrokersCloseTheConnection) {
  std::string levels = "a";
  for (int i = 1; i < 200; ++i) levels += "/a";
  EXPECT_TRUE(is_valid_topic_name(levels));
  EXPECT_TRUE(is_valid_filter(levels));
  for (const std::string& poison :
       {levels + "/a", std::string("x/a\xc2\x85"), std::string("x/\xef\xb7\x90"),
        std::string("x/\xef\xbf\xbf"), std::string("x/\x01"), std::string("\xed\xa0\x80"),
        std::string(65536, 'x')}) {
    EXPECT_FALSE(is_valid_topic_name(poison)) << poison;
    EXPECT_FALSE(is_valid_filter(poison)) << poison;
  }
}

TEST(TopicFilter, MatchesAsMqttSays) {
  EXPECT_TRUE(filter_matches("a/b", "a/b"));
  EXPECT_TRUE(filter_matches("a/+", "a/b"));
  EXPECT_TRUE(filter_matches("a/+", "a/"));
  EXPECT_TRUE(filter_matches("a/#", "a/b/c"));
  EXPECT_TRUE(filter_matches("a/#", "a"));
  EXPECT_TRUE(filter_matches("#", "a/b"));
  EXPECT_FALSE(filter_matches("a/+", "a"));
  EXPECT_FALSE(filter_matches("a/+", "a/b/c"));
  EXPECT_FALSE(filter_matches("a/b", "a/b/c"));
  EXPECT_FALSE(filter_matches("a", "ab"));
  EXPECT_FALSE(filter_matches("#", "$SYS/load"));
  EXPECT_FALSE(filter_matches("+/load", "$SYS/load"));
}

TEST(TopicPolicy, LetsADevicePublishOnlyItsOwnTopics) {
  const TopicPolicy policy(scheme, {}, {});
  EXPECT_TRUE(policy.may_publish("c", "robot1", "ntnu-slam/robot/robot1/update"));
  EXPECT_FALSE(policy.may_publish("c", "robot1", "ntnu-slam/robot/robot10/update"));
  EXPECT_FALSE(policy.may_publish("c", "robot10", "ntnu-slam/robot/robot1/update"));
  EXPECT_FALSE(policy.may_publish("c", "robot1", "ntnu-slam/gateway/pi1/state"));
  EXPECT_FALSE(policy.may_publish("c", "robot1", "ntnu-slam/server/robot1/cmd"));
}

TEST(TopicPolicy, LetsADeviceSubscribeToItsCommandsAndAllRobots) {
  const TopicPolicy policy(scheme, {}, {});
  for (const char* good : {"ntnu-slam/server/robot1/cmd", "ntnu-slam/server/robot1/#",
                           "ntnu-slam/robot/#", "ntnu-slam/robot/+/update"}) {
    EXPECT_TRUE(policy.may_subscribe("c", "robot1", good)) << good;
  }
  for (const char* bad :
       {"ntnu-slam/server/robot10/cmd", "ntnu-slam/server/+/cmd", "ntnu-slam/server/#",
        "ntnu-slam/#", "#", "ntnu-slam/+/robot1/cmd", "ntnu-slam/gateway/pi1/state"}) {
    EXPECT_FALSE(policy.may_subscribe("c", "robot1", bad)) << bad;
  }
}

TEST(TopicPolicy, AllowsTopicsThatTheConfigurationAdds) {
  const TopicPolicy policy(scheme, {"v2/robot/%c/+"}, {"v2/server/%c/#", "lab/+/x"});
  EXPECT_TRUE(policy.may_publish("NRF_5", "five", "v2/robot/NRF_5/adv"));
  EXPECT_FALSE(policy.may_publish("NRF_5", "five", "v2/robot/NRF_6/adv"));
  EXPECT_TRUE(policy.may_subscribe("NRF_5", "five", "v2/server/NRF_5/cmd"));
  EXPECT_TRUE(policy.may_subscribe("NRF_5", "five", "v2/server/NRF_5/#"));
  EXPECT_TRUE(policy.may_subscribe("NRF_5", "five", "lab/+/x"));
  EXPECT_FALSE(policy.may_subscribe("NRF_5", "five", "lab/#")) << "wider than what is allowed";
  EXPECT_FALSE(policy.may_subscribe("NRF_5", "five", "v2/server/+/cmd"));
}

TEST(TopicPolicy, AllowsDollarTopicsOnlyWhereTheyAreNamed) {
  const TopicPolicy policy(scheme, {"#"}, {"#", "$SYS/broker/uptime"});
  EXPECT_TRUE(policy.may_subscribe("c", "r", "anything"));
  EXPECT_TRUE(policy.may_subscribe("c", "r", "$SYS/broker/uptime"));
  for (const char* bad : {"$SYS/#", "$share/g/x", "$share/x", "$SYS/broker/load"})
    EXPECT_FALSE(policy.may_subscribe("c", "r", bad)) << bad;
  EXPECT_FALSE(policy.may_publish("c", "r", "$SYS/x"));
  const TopicPolicy named(scheme, {"%c/#"}, {"%c/#"});
  EXPECT_TRUE(named.may_publish("c$", "r", "c$/x"));
  EXPECT_FALSE(named.may_publish("$SYS", "r", "$SYS/x"));
  EXPECT_FALSE(named.may_subscribe("$share", "r", "$share/g/x"));
  EXPECT_FALSE(named.may_publish("ntnu-slam", "r", "ntnu-slam/server/other/cmd"));
}

}  // namespace
}  // namespace slamgw
