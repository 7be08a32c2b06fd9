// SPDX-License-Identifier: Apache-2.0
// States of gateways and robots from published documents, when gateways die, stall, have a wrong
// clock, or when robots move.
#include "web/server/roster.hpp"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "daemon/core/time.hpp"

namespace slamgw::web::test {
namespace {

using nlohmann::json;

constexpr std::int64_t second = 1000;
constexpr std::int64_t hour = 3600 * second;

std::string iso(std::int64_t ms) { return to_iso8601_ms(WallTime(std::chrono::milliseconds(ms))); }

class WebRoster : public testing::Test {
 protected:
  Roster roster;
  std::int64_t now = *unix_ms("2026-11-21T14:00:00Z");

  void hear(const std::string& gateway, const std::string& rest, const json& document,
            bool is_retained = false) {
    roster.on_document({gateway, rest}, document.dump(), now, is_retained);
    roster.update(now);
  }
  /// Publishes a gateway and its robot as online, by a clock that is `ahead`.
  void start(const std::string& gateway, const std::string& robot, std::int64_t ahead = 0) {
    hear(gateway, "state", {{"state", "online"}, {"since", iso(now + ahead)}});
    hear(gateway, "robots/" + robot,
         {{"state", "online"},
          {"mesh", "ble"},
          {"since", iso(now + ahead)},
          {"last_seen", iso(now + ahead)}});
  }
  void pass(std::int64_t ms) {
    now += ms;
    roster.update(now);
  }
};

TEST_F(WebRoster, RobotsOfDeadGatewayAreUnknownSinceItsDeath) {
  start("pi", "r");
  EXPECT_EQ(roster.robot("r").state, "online");
  EXPECT_EQ(roster.robot("r").mesh, "ble");
  pass(10 * second);
  const std::int64_t died = now;
  hear("pi", "state", {{"state", "offline"}});
  EXPECT_EQ(roster.gateway("pi").state, "gone");
  EXPECT_EQ(roster.gateway("pi").since_ms, died);
  pass(hour);
  EXPECT_EQ(roster.robot("r").state, "unknown");
  EXPECT_EQ(roster.robot("r").since_ms, died);
  EXPECT_EQ(roster.robot("r").gateway, "pi");
  EXPECT_EQ(roster.robot("r").heard_ms, died - 10 * second);
}

TEST_F(WebRoster, GatewayGoneBeforeStartHasNoTime) {
  hear("pi", "state", {{"state", "offline"}}, true);
  hear("pi", "robots/r", {{"state", "online"}, {"last_seen", iso(now - hour)}}, true);
  EXPECT_EQ(roster.gateway("pi").state, "gone");
  EXPECT_EQ(roster.gateway("pi").since_ms, 0);
  EXPECT_EQ(roster.robot("r").state, "unknown");
  EXPECT_EQ(roster.robot("r").since_ms, now - hour) << "when it was heard last";
}

TEST_F(WebRoster, GatewayWithoutMessagesBecomesSilent) {
  start("pi", "r");
  hear("pi", "stats", {{"uptime_s", 1}});
  const std::int64_t last = now;
  pass(Roster::silent_after_ms);
  EXPECT_EQ(roster.robot("r").state, "online");
  pass(1);
  EXPECT_EQ(roster.gateway("pi").state, "silent");
  EXPECT_EQ(roster.gateway("pi").since_ms, last);
  EXPECT_EQ(roster.robot("r").state, "unknown");
  hear("pi", "stats", {{"uptime_s", 40}});
  EXPECT_EQ(roster.robot("r").state, "online");
}

TEST_F(WebRoster, RetainedStateDoesNotKeepGatewayOnline) {
  hear("pi", "state", {{"state", "online"}}, true);
  EXPECT_EQ(roster.gateway("pi").state, "online");
  pass(Roster::silent_after_ms + 1);
  EXPECT_EQ(roster.gateway("pi").state, "silent");
}

TEST_F(WebRoster, TakesStateOfRobotFromOnlineGateway) {
  start("a", "r");
  pass(second);
  start("b", "r");
  hear("a", "robots/r", {{"state", "offline"}, {"last_seen", iso(now)}});
  EXPECT_EQ(roster.robot("r").gateway, "b");
  hear("b", "state", {{"state", "offline"}});
  EXPECT_EQ(roster.robot("r").gateway, "a") << "a is online and shows it as offline";
  EXPECT_EQ(roster.robot("r").state, "offline");
  hear("a", "state", {{"state", "offline"}});
  EXPECT_EQ(roster.robot("r").state, "unknown");
}

TEST_F(WebRoster, EverythingIsUnknownWithoutBroker) {
  start("pi", "r");
  roster.on_broker_lost(now);
  pass(second);
  EXPECT_EQ(roster.gateway("pi").state, "unknown");
  EXPECT_EQ(roster.robot("r").state, "unknown");
  EXPECT_EQ(roster.robot("r").since_ms, now - second);
  roster.on_broker_found();
  start("pi", "r");
  EXPECT_EQ(roster.robot("r").state, "online");
}

TEST_F(WebRoster, DetectsAndCorrectsClockThatIsAhead) {
  start("pi", "r", 3 * hour);
  EXPECT_EQ(roster.gateway("pi").clock_ahead_ms, 3 * hour);
  EXPECT_EQ(roster.robot("r").heard_ms, now);
  EXPECT_EQ(roster.robot("r").since_ms, now);
  pass(5 * second);
  hear("pi", "numbers", {{"robots", {{"r", {{"last_heard", iso(now + 3 * hour)}}}}}});
  EXPECT_EQ(roster.robot("r").heard_ms, now);
  hear("pi", "state", {{"state", "offline"}});
  pass(hour);
  EXPECT_EQ(roster.gateway("pi").clock_ahead_ms, 3 * hour) << "no newer document corrects it";
  EXPECT_EQ(roster.robot("r").heard_ms, now - hour);
}

TEST_F(WebRoster, DetectsClockByRetainedTimeInFuture) {
  hear("pi", "state", {{"state", "offline"}}, true);
  hear("pi", "robots/r", {{"state", "online"}, {"last_seen", iso(now + 2 * hour)}}, true);
  EXPECT_EQ(roster.gateway("pi").clock_ahead_ms, 2 * hour);
}

TEST_F(WebRoster, DetectsClockThatIsBehindByMessagesAndStats) {
  start("pi", "r", -hour);
  EXPECT_EQ(roster.gateway("pi").clock_ahead_ms, 0) << "a robot may have been silent for an hour";
  roster.on_robot_message("r", "pi", iso(now - hour), now);
  roster.update(now);
  EXPECT_EQ(roster.gateway("pi").clock_ahead_ms, 0) << "messages may have waited on disk";
  hear("pi", "stats", {{"uptime_s", 0}});
  EXPECT_EQ(roster.gateway("pi").clock_ahead_ms, -hour);
  EXPECT_EQ(roster.robot("r").heard_ms, now);
}

TEST_F(WebRoster, TrustsClockThatWasCorrected) {
  start("pi", "r", -3 * hour);
  hear("pi", "stats", {{"uptime_s", 0}});
  roster.on_robot_message("r", "pi", iso(now), now);
  roster.update(now);
  EXPECT_EQ(roster.gateway("pi").clock_ahead_ms, 0) << "its start was before the step";
}

TEST_F(WebRoster, CountsDirectMessageAsHeard) {
  start("pi", "r");
  pass(20 * second);
  roster.on_robot_message("r", "", "", now);
  EXPECT_EQ(roster.last_heard_ms("r"), now);
}

TEST_F(WebRoster, ReturnsOnlyChanges) {
  start("pi", "r");
  EXPECT_TRUE(roster.update(now).empty());
  roster.on_document({"pi", "state"}, R"({"state":"offline"})", now, false);
  const auto changes = roster.update(now);
  ASSERT_EQ(changes.size(), 2u);
  const json change = json::parse(*changes.at("robot/r"));
  EXPECT_EQ(change["topic"], "$web/robot/r");
  EXPECT_EQ(change["payload"],
            (json{{"state", "unknown"}, {"since", now}, {"heard", now}, {"gateway", "pi"}}));
  EXPECT_EQ(json::parse(*roster.texts().at("gateway/pi"))["payload"]["state"], "gone");
}

TEST_F(WebRoster, EscapesNames) {
  start("p\"i", "\"r\n");
  EXPECT_EQ(json::parse(*roster.texts().at("robot/\"r\n"))["topic"], "$web/robot/\"r\n");
  EXPECT_EQ(json::parse(*roster.texts().at("robot/\"r\n"))["payload"]["gateway"], "p\"i");
}

TEST_F(WebRoster, ForgetsWithdrawnDocuments) {
  start("pi", "r");
  roster.on_document({"pi", "robots/r"}, "", now, false);
  roster.on_document({"pi", "state"}, "", now, false);
  roster.update(now);
  EXPECT_TRUE(roster.texts().empty());
}

TEST_F(WebRoster, ForgetsTimesOfWithdrawnGateway) {
  start("pi", "r");
  const std::int64_t heard = now;
  for (const std::string withdrawn : {"numbers", "state"}) {
    hear("x", "state", {{"state", "online"}, {"since", iso(now)}});
    hear("x", "robots/r", {{"state", "offline"}, {"last_seen", iso(heard)}});
    pass(hour);
    hear("x", "numbers", {{"robots", {{"r", {{"last_heard", iso(now)}}}}}});
    EXPECT_EQ(roster.robot("r").heard_ms, now);
    roster.on_document({"x", withdrawn}, "", now, false);
    roster.update(now);
    EXPECT_EQ(roster.robot("r").heard_ms, heard) << withdrawn;
  }
}

TEST_F(WebRoster, BoundsGateways) {
  constexpr int names = 30'000;
  const auto publish = [&](const std::string& rest, const char* payload) {
    for (int i = 0; i < names; ++i) {
      const std::string gateway = "g" + std::to_string(i);
      roster.on_document({gateway, rest}, payload, now, false);
      if (rest == "thread") roster.on_document({gateway, rest}, "", now, false);
    }
  };
  publish("thread", "{}");
  EXPECT_TRUE(roster.texts().empty());
  start("pi", "r");
  publish("state", "{}");
  publish("numbers", R"({"robots":{"r":{"last_heard":"2026-11-21T14:00:00Z"}}})");
  publish("robots/r", R"({"state":"online"})");
  EXPECT_EQ(roster.texts().size(), Roster::max_gateways + 1) << "and one robot";
  EXPECT_EQ(roster.gateway("pi").state, "online");
}

TEST_F(WebRoster, BoundsRobots) {
  start("pi", "r");
  for (int i = 0; i < 30'000; ++i)
    roster.on_document({"pi", "robots/r" + std::to_string(i)}, R"({"state":"online"})", now, false);
  EXPECT_EQ(roster.texts().size(), 1 + Roster::max_robots) << "a gateway, and robots";
  EXPECT_EQ(roster.robot("r").state, "online");
}

TEST_F(WebRoster, TakesLastHeardOnlyFromGatewaysThatShowRobot) {
  start("pi", "r");
  const std::int64_t heard = now;
  pass(hour);
  hear("x", "numbers", {{"robots", {{"r", {{"last_heard", iso(now)}}}}}});
  EXPECT_EQ(roster.robot("r").heard_ms, heard);
}

TEST_F(WebRoster, IgnoresInvalidDocuments) {
  for (const char* payload : {"x", "[]", "1", R"({"robots":[1]})", R"({"robots":{"r":5}})",
                              R"({"state":5,"since":[],"uptime_s":"x"})",
                              R"({"state":"up","since":"9999-99-99T99:99:99Z"})",
                              R"({"robots":{"r":{"last_heard":"2026-11-21T99:00:-1Z"}}})"}) {
    for (const char* rest : {"state", "stats", "numbers", "robots/r", "robots/", "other"})
      roster.on_document({"g", rest}, payload, now, false);
    roster.on_robot_message("r", "g", payload, now);
    roster.update(now);
    EXPECT_NE(roster.robot("r").state, "online") << payload;
  }
}

TEST(WebTimes, AreParsedFromIso8601) {
  EXPECT_EQ(unix_ms("2026-11-21T13:57:43.613Z"), 1795269463613);
  EXPECT_EQ(unix_ms("1970-01-01T00:00:00Z"), 0);
  for (const char* text : {"", "2026", "2026-11-21", "2026-13-21T00:00:00Z"})
    EXPECT_FALSE(unix_ms(text)) << text;
}

}  // namespace
}  // namespace slamgw::web::test
