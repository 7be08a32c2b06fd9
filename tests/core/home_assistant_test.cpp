// SPDX-License-Identifier: Apache-2.0
// Documents for Home Assistant: their ids, and when they are written and removed. With a real Home
// Assistant: tests/e2e/home_assistant_test.cpp.
#include "daemon/core/home_assistant.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "tests/core/gateway_rig.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;
using nlohmann::json;

constexpr std::string_view plain_characters =
    "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_-";

std::string topic_of(std::string_view robot, const std::string& prefix = "ntnu-slam") {
  return home_assistant_topic(TopicScheme(prefix, "pi1"), robot);
}

json document_of(std::string_view robot, const std::string& gateway = "pi1") {
  return json::parse(home_assistant_document(TopicScheme("ntnu-slam", gateway), robot,
                                             UpdateMode::positions, true));
}

TEST(HomeAssistant, GivesEachRobotATopicOfItsOwn) {
  EXPECT_EQ(topic_of("lego-1"), "homeassistant/device/ntnu-slam/lego-1/config");
  EXPECT_EQ(topic_of("NRF_5", "v2/lab"), "homeassistant/device/v2_2flab/NRF__5/config");
  const std::vector<std::string> names{"a b", "a_b", "a__b", "a_20b", "a-b", "a.b",
                                       "ab",  "aB",  "æ",    "\"",    "~",   "{{1}}"};
  std::set<std::string> topics;
  for (const std::string& name : names) {
    const std::string topic = topic_of(name);
    topics.insert(topic);
    EXPECT_EQ(std::count(topic.begin(), topic.end(), '/'), 4) << topic;
    EXPECT_EQ(topic.find_first_not_of(std::string(plain_characters) + "/"), topic.npos);
  }
  EXPECT_EQ(topics.size(), names.size());
  EXPECT_NE(topic_of("b", "p_a"), topic_of("b", "p/a"));
}

TEST(HomeAssistant, WritesHostileNamesAsText) {
  for (const std::string name :
       {R"("}],"x":[{")", R"(\)", "{{ states }}", "~", "\xf0\x9f\xa4\x96"}) {
    ASSERT_TRUE(is_valid_level(name));
    const json document = document_of(name);
    EXPECT_EQ(document["device"]["name"], name);
    EXPECT_EQ(document["components"]["stop"]["command_topic"], "ntnu-slam/server/" + name + "/run");
    for (const char* entity : {"presence", "x", "y", "signal"})
      EXPECT_EQ(document["components"][entity]["value_template"],
                document_of("r")["components"][entity]["value_template"]);
  }
}

TEST(HomeAssistant, IdentifiesARobotAlikeAtEachGateway) {
  json here = document_of("r", "pi1");
  json there = document_of("r", "pi2");
  EXPECT_NE(here, there) << "its presence is at another topic";
  EXPECT_EQ(here["device"], there["device"]);
  for (json* document : {&here, &there}) {
    document->erase("availability");
    json& entities = (*document)["components"];
    entities["presence"].erase("availability");
    for (const char* entity : {"presence", "signal"}) entities[entity].erase("state_topic");
  }
  EXPECT_EQ(here, there);
}

TEST(HomeAssistant, ReadsCoordinatesAsTheyArePublished) {
  const TopicScheme topics("p", "g");
  const auto x_of = [&](UpdateMode mode) {
    return json::parse(home_assistant_document(topics, "r", mode, false))["components"]["x"];
  };
  EXPECT_EQ(x_of(UpdateMode::json)["value_template"],
            "{{ (value_json | default({})).x | default(none) }}");
  EXPECT_FALSE(x_of(UpdateMode::json).contains("encoding")) << "text";
  for (const UpdateMode mode : {UpdateMode::positions, UpdateMode::raw}) {
    EXPECT_EQ(x_of(mode)["value_template"],
              "{{ value | unpack('<h', 0) if value | length > 3 else none }}");
    EXPECT_EQ(x_of(mode)["encoding"], "") << "bytes";
  }
}

class HomeAssistantDocuments : public test::SharedGatewayRig {
 protected:
  void SetUp() override {
    SharedGatewayRig::SetUp();
    gateway.presence().describe_robots(true, now);
    broker_comes();
  }
  void is(const std::string& robot, Presence presence) {
    say(PresenceChange{Mesh::ble, robot, presence, "0x0100"});
  }
  void comes(const std::string& robot) {
    held.insert(robot);
    is(robot, Presence::online);
  }
  /// Returns the documents written since the last call: "a" without a signal, "a+" with one, "-a"
  /// for a removed one.
  std::vector<std::string> written() {
    std::vector<std::string> all;
    for (const Upload& upload : drain<Upload>()) {
      const BrokerMessage& message = upload.message;
      if (!message.topic.starts_with("homeassistant/")) continue;
      EXPECT_TRUE(message.retain);
      const std::string robot = message.topic.substr(topic_of("").find("/config"));
      const std::string id = robot.substr(0, robot.find('/'));
      const bool has_signal = as_text(message.payload).find("dBm") != std::string_view::npos;
      all.push_back(message.payload.empty() ? "-" + id : id + (has_signal ? "+" : ""));
    }
    return all;
  }
  using Written = std::vector<std::string>;
};

TEST_F(HomeAssistantDocuments, AreWrittenOnceForEachRobotAndConnection) {
  comes("a");
  comes("b");
  EXPECT_EQ(written(), (Written{"a", "b"}));
  is("a", Presence::offline);
  comes("a");
  EXPECT_EQ(written(), Written{}) << "already written";
  broker_is(false);
  broker_is(true);
  gateway.presence().announce_all(now);
  EXPECT_EQ(written(), (Written{"a", "b"})) << "a broker may have lost them";
}

TEST_F(HomeAssistantDocuments, HaveTheSignalAsSoonAsItIsKnown) {
  comes("a");
  EXPECT_EQ(written(), Written{"a"});
  Report report = update_from("a", {1, 0, 2, 0});
  report.mesh = Mesh::ble;
  report.radio = RadioFacts{-70, {}, {}};
  say(report);
  EXPECT_EQ(written(), Written{"a+"});
  report.radio.reset();
  say(report);
  now.mono += 1h;
  say(report);
  EXPECT_EQ(written(), Written{}) << "a message without a signal changes nothing";
}

TEST_F(HomeAssistantDocuments, AreRemovedWithAForgottenRobot) {
  comes("a");
  is("a", Presence::offline);
  written();
  EXPECT_EQ(gateway.forget("a"), "");
  EXPECT_EQ(written(), Written{"-a"});
  elsewhere.insert("b");
  EXPECT_EQ(gateway.forget("b"), "");
  EXPECT_EQ(written(), Written{}) << "another gateway has described it";
  broker_is(false);
  EXPECT_EQ(gateway.forget("c"), "");
  EXPECT_EQ(written(), Written{});
  broker_is(true);
  EXPECT_EQ(written(), Written{"-c"});
}

TEST_F(HomeAssistantDocuments, AreWrittenByTheGatewayThatARobotMovesTo) {
  comes("a");
  written();
  gateway.presence().on_given_up("a");
  EXPECT_EQ(written(), Written{}) << "the next gateway writes its own over it";
  comes("a");
  EXPECT_EQ(written(), Written{"a"});
  session_comes("a");
  EXPECT_EQ(written(), Written{"a"}) << "another gateway may have had it";
}

TEST_F(HomeAssistantDocuments, AreSwitchedWhileTheDaemonRuns) {
  comes("a");
  written();
  gateway.presence().describe_robots(false, now);
  EXPECT_EQ(written(), Written{"-a"});
  comes("b");
  is("b", Presence::offline);
  EXPECT_EQ(gateway.forget("b"), "");
  EXPECT_EQ(written(), Written{}) << "nothing below homeassistant/ without the key";
  gateway.presence().describe_robots(true, now);
  EXPECT_EQ(written(), Written{"a"});
}

TEST_F(HomeAssistantDocuments, AreRemovedOnceTheBrokerIsBack) {
  comes("a");
  comes("b");
  broker_is(false);
  gateway.presence().describe_robots(false, now);
  gateway.presence().describe_robots(true, now);
  comes("a");
  written();
  broker_is(true);
  gateway.presence().announce_all(now);
  EXPECT_EQ(written(), (Written{"-b", "a", "b"})) << "the one that was heard stays";
}

}  // namespace
}  // namespace slamgw
