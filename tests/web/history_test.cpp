// SPDX-License-Identifier: Apache-2.0
#include "web/server/history.hpp"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "web/server/roster.hpp"

namespace slamgw::web::test {
namespace {

using nlohmann::json;

constexpr std::int64_t minute = 60'000;

class WebHistory : public testing::Test {
 protected:
  Roster roster;
  History history;
  std::int64_t now = 1'800'000'000'000 / History::slot_ms * History::slot_ms;

  void say(const std::string& rest, const json& document, const char* gateway = "g") {
    roster.on_document({gateway, rest}, document.dump(), now, false);
    roster.update(now);
  }
  void count(int repeats, const char* gateway = "g") {
    const json numbers = {
        {"rssi_dbm", -60}, {"latency_p50_us", 1900}, {"repeats", repeats}, {"gaps", 1}};
    history.on_numbers(roster, gateway, json{{"robots", {{"r", numbers}}}}.dump(), now);
  }
  void pass(std::int64_t ms) {
    for (const std::int64_t end = now + ms; now < end; now += History::sample_ms) {
      say("stats", {{"uptime_s", 1}});
      history.update(roster, now);
    }
  }
  json shown(const std::string& robot = "r") { return json::parse(history.text(robot, now)); }
};

TEST_F(WebHistory, ShowsShareOfTimeOnline) {
  say("state", {{"state", "online"}});
  say("robots/r", {{"state", "online"}, {"last_seen", "2027-01-15T08:00:00Z"}});
  pass(15 * minute);
  say("robots/r", {{"state", "offline"}, {"last_seen", "2027-01-15T08:00:00Z"}});
  pass(15 * minute - 1);
  const json shown = this->shown();
  EXPECT_EQ(shown["from"], now - 3 * History::slot_ms);
  EXPECT_EQ(shown["online"], (json{100, 50, 0, nullptr})) << shown;
}

TEST_F(WebHistory, ShowsNullWhileGatewayIsGone) {
  say("state", {{"state", "online"}});
  say("robots/r", {{"state", "online"}, {"last_seen", "2027-01-15T08:00:00Z"}});
  pass(10 * minute);
  say("state", {{"state", "offline"}});
  pass(10 * minute);
  EXPECT_EQ(shown()["online"], (json{100, nullptr, nullptr})) << shown();
}

TEST_F(WebHistory, KeepsSignalLatencyAndCountsOfEachSlot) {
  say("state", {{"state", "online"}});
  say("robots/r", {{"state", "online"}, {"last_seen", "2027-01-15T08:00:00Z"}});
  count(5);
  pass(minute);
  count(9);
  count(2);  // its gateway has restarted
  count(3);
  EXPECT_EQ(shown()["repeats"], json{5});
  EXPECT_EQ(shown()["gaps"], json{0});
  EXPECT_EQ(shown()["rssi_dbm"], json{-60});
  EXPECT_EQ(shown()["latency_us"], json{1900});
}

TEST_F(WebHistory, CountsOnlyAtTheGatewayThatServesTheRobot) {
  for (const char* const gateway : {"g", "h"}) say("state", {{"state", "online"}}, gateway);
  say("robots/r", {{"state", "online"}, {"last_seen", "2027-01-15T08:00:00Z"}}, "g");
  say("robots/r", {{"state", "offline"}, {"last_seen", "2027-01-15T07:00:00Z"}}, "h");
  for (const int repeats : {5, 6, 8}) {
    count(repeats, "g");
    count(100, "h");
  }
  pass(minute);
  EXPECT_EQ(shown()["repeats"], json{3});
  say("robots/r", {{"state", "offline"}, {"last_seen", "2027-01-15T08:00:00Z"}}, "g");
  say("robots/r", {{"state", "online"}, {"last_seen", "2027-01-15T08:00:01Z"}}, "h");
  for (const int repeats : {101, 102}) {
    count(8, "g");
    count(repeats, "h");
  }
  EXPECT_EQ(shown()["repeats"], json{4}) << "counts of two gateways are not compared";
}

TEST_F(WebHistory, CoversOneDay) {
  say("state", {{"state", "online"}});
  say("robots/r", {{"state", "online"}, {"last_seen", "2027-01-15T08:00:00Z"}});
  pass(10 * minute);
  now += 3 * 24 * 60 * minute;
  pass(10 * minute);
  const json shown = this->shown();
  EXPECT_EQ(shown["online"].size(), History::slots);
  EXPECT_EQ(shown["online"].front(), nullptr) << "slots of three days ago are forgotten";
}

TEST_F(WebHistory, StartsOverWhenClockIsSetBack) {
  constexpr std::int64_t year = 365 * 24 * 60 * minute;
  say("state", {{"state", "online"}});
  for (const char* const robot : {"robots/r", "robots/leaves"})
    say(robot, {{"state", "online"}, {"last_seen", "2027-01-15T08:00:00Z"}});
  pass(minute);
  now += year;
  pass(minute);
  ASSERT_EQ(history.size(), 2u);
  roster.on_document({"g", "robots/leaves"}, "", now, false);
  now -= year;
  const std::int64_t set_back = now / History::slot_ms * History::slot_ms;
  pass(60 * minute);
  const json shown = this->shown();
  EXPECT_EQ(shown["from"], set_back);
  EXPECT_EQ(shown["online"], (json{100, 100, 100, 100, 100, 100, 100})) << shown;
  EXPECT_EQ(history.size(), 1u) << "a robot that left is not kept for a year";
}

TEST_F(WebHistory, IsBoundedAndForgetsRobotsThatAreGone) {
  say("state", {{"state", "online"}});
  for (std::size_t i = 0; i < History::max_robots + 10; ++i)
    say("robots/" + std::to_string(i),
        {{"state", "online"}, {"last_seen", "2027-01-15T08:00:00Z"}});
  history.update(roster, now);
  EXPECT_EQ(history.size(), History::max_robots);
  EXPECT_EQ(shown("unknown")["online"], json{nullptr});
  roster.on_broker_found();
  now += 25 * 60 * minute;
  history.update(roster, now);
  EXPECT_EQ(history.size(), 0u);
}

TEST_F(WebHistory, IgnoresInvalidDocuments) {
  say("state", {{"state", "online"}});
  say("robots/r", {{"state", "online"}, {"last_seen", "2027-01-15T08:00:00Z"}});
  for (const char* payload :
       {"", "x", "[]", R"({"robots":1})", R"({"robots":{"r":1}})",
        R"({"robots":{"r":{"rssi_dbm":"x","latency_p50_us":-1,"repeats":-5,"gaps":1e300}}})",
        R"({"robots":{"r":{"rssi_dbm":99999,"repeats":18446744073709551615}}})"})
    history.on_numbers(roster, "g", payload, now);
  EXPECT_EQ(shown()["repeats"], json{nullptr});
}

}  // namespace
}  // namespace slamgw::web::test
