// SPDX-License-Identifier: Apache-2.0
// Findings of `slam-gatewayctl check`: habits that cost a robot messages, air time or battery.
#include <gtest/gtest.h>

#include <fmt/format.h>

#include "ctl/host/robot_check.hpp"

namespace slamgw::ctl {
namespace {

using nlohmann::json;

json arrived(double second, json more = {}) {
  json event{{"event", "arrived"},
             {"at", fmt::format("2026-11-28T10:{:02d}:{:06.3f}Z", static_cast<int>(second) / 60,
                                second - 60 * (static_cast<int>(second) / 60))},
             {"mesh", "thread"},
             {"type", "update"},
             {"qos", 1},
             {"bytes", 8}};
  if (more.is_object()) event.update(more);
  return event;
}

WatchedRobot steady() {
  WatchedRobot robot;
  for (int i = 0; i < 60; ++i) robot.events.push_back(arrived(i));
  robot.client = {{"keep_alive_s", 60}, {"has_answered", true}};
  robot.watched = std::chrono::seconds{60};
  return robot;
}

const Finding* find(const std::vector<Finding>& findings, const std::string& step) {
  for (const Finding& finding : findings)
    if (finding.step == step) return &finding;
  return nullptr;
}

Health health_of(const WatchedRobot& robot, const std::string& step) {
  const auto findings = judge_robot(robot);
  const Finding* finding = find(findings, step);
  if (finding == nullptr) return Health::unknown;
  EXPECT_EQ(finding->health == Health::well, finding->remedy.empty()) << finding->detail;
  return finding->health;
}

TEST(RobotCheck, FindsNoProblemOfHealthyRobot) {
  for (const Finding& finding : judge_robot(steady()))
    EXPECT_EQ(finding.health, Health::well) << finding.step << finding.detail;
}

TEST(RobotCheck, NamesSilence) {
  WatchedRobot robot;
  EXPECT_EQ(health_of(robot, "messages"), Health::problem);
}

TEST(RobotCheck, NamesRepeatsWithoutDup) {
  WatchedRobot robot = steady();
  robot.events.push_back({{"event", "repeat"}, {"mesh", "thread"}, {"dup", false}});
  EXPECT_EQ(health_of(robot, "DUP"), Health::warning);
  robot = steady();
  robot.events.push_back({{"event", "repeat"}, {"mesh", "thread"}, {"dup", true}});
  robot.events.push_back({{"event", "repeat"}, {"mesh", "ble"}});
  EXPECT_EQ(health_of(robot, "DUP"), Health::unknown);
}

TEST(RobotCheck, NamesEndlessRepeats) {
  WatchedRobot robot = steady();
  for (int i = 0; i < 70; ++i) robot.events.push_back({{"event", "repeat"}, {"mesh", "ble"}});
  EXPECT_EQ(health_of(robot, "repeats"), Health::problem);
}

TEST(RobotCheck, NamesPublishedRepeatsWithoutDup) {
  WatchedRobot robot;
  for (int i = 0; i < 20; ++i)
    for (int copy = 0; copy < 3; ++copy)
      robot.events.push_back(
          arrived(3 * i + copy, {{"message_id", 100 + i}, {"payload", "01"}, {"dup", false}}));
  EXPECT_EQ(health_of(robot, "DUP"), Health::problem);
  robot.events.clear();
  for (int i = 0; i < 20; ++i)
    robot.events.push_back(arrived(i, {{"message_id", 100 + i}, {"payload", "01"}}));
  EXPECT_EQ(health_of(robot, "DUP"), Health::unknown);
}

TEST(RobotCheck, AttributesRepeatsToRadio) {
  WatchedRobot robot;
  for (int i = 0; i < 40; ++i) robot.events.push_back(arrived(i + (i % 3 == 0 ? 0.9 : 0)));
  for (int i = 0; i < 10; ++i)
    robot.events.push_back({{"event", "repeat"}, {"mesh", "thread"}, {"dup", true}});
  EXPECT_EQ(health_of(robot, "losses"), Health::warning);
  EXPECT_EQ(health_of(robot, "pace"), Health::unknown);
}

TEST(RobotCheck, NamesMessagesThatAskForNoAcknowledgement) {
  WatchedRobot robot;
  for (int i = 0; i < 20; ++i) robot.events.push_back(arrived(i, {{"qos", 0}}));
  EXPECT_EQ(health_of(robot, "acknowledgement"), Health::warning);
}

TEST(RobotCheck, NamesStrayOctetAndInvalidPayload) {
  WatchedRobot robot = steady();
  robot.events.push_back(arrived(60, {{"stray_octet", true}}));
  robot.events.push_back(arrived(61, {{"why", "not a valid update: published under rejected/"}}));
  EXPECT_EQ(health_of(robot, "stray octet"), Health::warning);
  EXPECT_EQ(health_of(robot, "payload"), Health::problem);
}

TEST(RobotCheck, NamesFewOfManyRefusals) {
  WatchedRobot robot = steady();
  for (int i = 0; i < 100; ++i)
    robot.events.push_back({{"event", "refused"}, {"why", fmt::format("topic {}", i)}});
  EXPECT_EQ(health_of(robot, "refused"), Health::problem);
  EXPECT_LT(judge_robot(robot).size(), 15U);
}

TEST(RobotCheck, NamesAnIrregularClock) {
  WatchedRobot robot;
  for (int i = 0; i < 40; ++i) robot.events.push_back(arrived(i + (i % 3 == 0 ? 0.9 : 0)));
  EXPECT_EQ(health_of(robot, "pace"), Health::warning);
  EXPECT_EQ(health_of(steady(), "pace"), Health::well);
}

TEST(RobotCheck, NamesSegmentsToAGroup) {
  WatchedRobot robot = steady();
  robot.events.push_back(arrived(60, {{"bytes", 12}}));
  robot.client = nullptr;
  robot.config["models"] =
      json::array({{{"name", "Health server"}, {"publishes_to", "0xc000"}},
                   {{"name", "sensor_update client"}, {"publishes_to", "0x0001"}}});
  EXPECT_EQ(health_of(robot, "segments to a group"), Health::unknown);
  robot.config["models"][1]["publishes_to"] = "0xc000";
  EXPECT_EQ(health_of(robot, "segments to a group"), Health::problem);
}

TEST(RobotCheck, NamesUnansweredCommandsAndRegister) {
  WatchedRobot robot = steady();
  const std::string topic = "ntnu-slam/server/r1/cmd";
  robot.events.push_back({{"event", "outcome"}, {"outcome", "timeout"}, {"topic", topic}});
  EXPECT_EQ(health_of(robot, "commands"), Health::problem);
  robot.client["topics"] = json::array({{{"name", topic}, {"told", false}}});
  const auto findings = judge_robot(robot);
  EXPECT_NE(find(findings, "commands")->remedy.find("REGACK"), std::string::npos);
}

TEST(RobotCheck, NamesShortOrMissingKeepAlive) {
  WatchedRobot robot = steady();
  robot.client["keep_alive_s"] = 3;
  EXPECT_EQ(health_of(robot, "keep-alive"), Health::warning);
  robot.client["keep_alive_s"] = 0;
  EXPECT_EQ(health_of(robot, "keep-alive"), Health::warning);
}

TEST(RobotCheck, SurvivesAnswersOfAnyShape) {
  for (const char* text : {"null", "5", "[]", "{}", R"({"event":5,"at":7,"topics":3,"models":{}})",
                           R"({"event":"arrived","at":"x","bytes":-1,"qos":"y"})"}) {
    WatchedRobot robot;
    robot.events.assign(20, json::parse(text));
    robot.client = robot.config = json::parse(text);
    EXPECT_FALSE(judge_robot(robot).empty()) << text;
  }
}

}  // namespace
}  // namespace slamgw::ctl
