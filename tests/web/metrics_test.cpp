// SPDX-License-Identifier: Apache-2.0
// Metrics from documents of gateways, as recorded from a running one. `promtool check metrics`
// reads those of the built program in ./dev browser-test.
#include "web/server/metrics.hpp"

#include <gtest/gtest.h>

#include "web/server/exposition.hpp"
#include "web/server/mirror.hpp"

namespace slamgw::web::test {
namespace {

class WebMetrics : public testing::Test {
 protected:
  Topics topics{"ntnu-slam"};
  LastKnown known;
  static constexpr std::int64_t now = 1'795'269'500'000;  // 2026-11-21T13:58:20Z
  Roster roster;
  OutcomeCounts outcomes;

  void hear(const std::string& rest, const std::string& payload) {
    const std::string topic = "ntnu-slam/gateway/" + rest;
    known.keep(topic, std::make_shared<const std::string>(*to_page(
                          {topic, payload, now, false, {}, {}, {}}, topics.kind_of(topic))));
    roster.on_document(topics.gateway_topic(topic), payload, now, false);
    roster.update(now);
  }
  void hear_robot(const std::string& gateway, const std::string& at) {
    roster.on_robot_message("r", gateway, at, now);
  }
  std::string text() const {
    return metrics_text({.version = "0.1.0"}, topics, known, roster, outcomes);
  }
  bool has(const std::string& line) const {
    return text().find("\n" + line + "\n") != std::string::npos;
  }
};

TEST_F(WebMetrics, CountMessagesOfEachMesh) {
  hear("g/state", R"({"state":"online"})");
  hear("g/stats", R"({"messages":{"up":7,"down":5},
                      "meshes":{"ble":{"state":"up","messages":{"up":3,"down":1}},
                                "thread":{"state":"up","messages":{"up":4,"down":2}}}})");
  EXPECT_TRUE(has(R"(slamgw_gateway_messages_total{gateway="g",mesh="ble",direction="up"} 3)"))
      << text();
  EXPECT_TRUE(has(R"(slamgw_gateway_messages_total{gateway="g",mesh="thread",direction="up"} 4)"));
  EXPECT_EQ(text().find(R"(messages_total{gateway="g",direction="up"})"), std::string::npos);
  EXPECT_TRUE(has(R"(slamgw_gateway_messages_total{gateway="g",mesh="ble",direction="down"} 1)"));
  EXPECT_TRUE(has(R"(slamgw_gateway_messages_total{gateway="g",direction="down"} 2)"))
      << "no mesh carried them";
}

TEST_F(WebMetrics, ShowStatsOfGateway) {
  hear("g/state", R"({"state":"online"})");
  hear(
      "g/stats",
      R"({"uptime_s":12,"messages":{"up":7,"down":2,"lost":3},"store":{"depth":3,"bytes":99,"dead_letter_bytes":42},
           "broker":{"state":"up"},"robots":{"online":4,"contested":2},
           "meshes":{"ble":{"state":"down","latency":{"count":9,"sum_us":1500,"buckets":1}},
                     "thread":{"state":"up","latency":{"count":5,"sum_us":2500,"buckets":[
                         {"le_us":500,"count":2},{"le_us":2500,"count":4}]}},
                     "x":{"state":"disabled"}}})");
  EXPECT_TRUE(has(R"(slamgw_gateway_up{gateway="g"} 1)")) << text();
  EXPECT_TRUE(has(R"(slamgw_gateway_uptime_seconds{gateway="g"} 12)"));
  EXPECT_TRUE(has(R"(slamgw_gateway_messages_total{gateway="g",direction="up"} 7)"));
  EXPECT_TRUE(has("# TYPE slamgw_gateway_messages_total counter"));
  EXPECT_TRUE(has(R"(slamgw_gateway_lost_messages_total{gateway="g"} 3)"));
  EXPECT_TRUE(has(R"(slamgw_gateway_store_messages{gateway="g"} 3)"));
  EXPECT_TRUE(has(R"(slamgw_gateway_dead_letter_bytes{gateway="g"} 42)"));
  EXPECT_TRUE(has(R"(slamgw_gateway_mesh_up{gateway="g",mesh="ble"} 0)"));
  EXPECT_TRUE(has(R"(slamgw_gateway_mesh_up{gateway="g",mesh="thread"} 1)"));
  EXPECT_TRUE(has(R"(slamgw_gateway_robots_contested{gateway="g"} 2)"));
  EXPECT_EQ(text().find("mesh=\"x\""), std::string::npos);
  EXPECT_NE(text().find(R"(
# TYPE slamgw_latency_seconds histogram
slamgw_latency_seconds_bucket{gateway="g",mesh="thread",le="0.0005"} 2
slamgw_latency_seconds_bucket{gateway="g",mesh="thread",le="0.0025"} 4
slamgw_latency_seconds_bucket{gateway="g",mesh="thread",le="+Inf"} 5
slamgw_latency_seconds_sum{gateway="g",mesh="thread"} 0.0025
slamgw_latency_seconds_count{gateway="g",mesh="thread"} 5
)"),
            std::string::npos)
      << "no histogram of the BLE mesh, whose buckets are invalid: " << text();
}

TEST_F(WebMetrics, ShowRefusingBrokerAsUp) {
  hear("g/state", R"({"state":"online"})");
  for (const auto& [state, value] : {std::pair{"up", '1'}, {"refusing", '1'}, {"down", '0'}}) {
    hear("g/stats", std::string(R"({"broker":{"state":")") + state + "\"}}");
    EXPECT_TRUE(has(std::string(R"(slamgw_gateway_broker_up{gateway="g"} )") + value)) << state;
  }
}

TEST_F(WebMetrics, ShowNumbersOfRobotsInBaseUnits) {
  hear("g/robots/r", R"({"state":"online","mesh":"ble"})");
  hear("g/numbers",
       R"({"robots":{"r":{"up":70,"down":2,"repeats":1,"rate_hz":5.1,"latency_p50_us":1500,
           "latency_p99_us":9000,"rssi_dbm":-70,"last_heard":"2026-11-21T13:57:43.500Z","mesh":"ble",
           "meshes":{"ble":{"up":60,"down":2,"repeats":1},"thread":{"up":10}}}}})");
  EXPECT_TRUE(
      has(R"(slamgw_robot_messages_total{gateway="g",robot="r",mesh="ble",direction="up"} 60)"));
  EXPECT_TRUE(
      has(R"(slamgw_robot_messages_total{gateway="g",robot="r",mesh="thread",direction="up"} 10)"));
  EXPECT_TRUE(has(R"(slamgw_robot_repeats_total{gateway="g",robot="r",mesh="ble"} 1)"));
  EXPECT_TRUE(has(
      R"(slamgw_robot_latency_seconds{gateway="g",robot="r",mesh="ble",quantile="0.5"} 0.0015)"));
  EXPECT_TRUE(has("# TYPE slamgw_robot_latency_seconds summary"));
  EXPECT_TRUE(has(R"(slamgw_robot_rssi_dbm{gateway="g",robot="r",mesh="ble"} -70)"));
  const std::string last_heard =
      R"(slamgw_robot_last_heard_timestamp_seconds{gateway="g",robot="r",mesh="ble"} )";
  EXPECT_TRUE(has(last_heard + "1795269463.5")) << text();
  EXPECT_TRUE(has(R"(slamgw_robot_online{gateway="g",robot="r",mesh="ble"} 1)"));
}

TEST_F(WebMetrics, ShowTimeOfLastMessageOfRobot) {
  hear("g/robots/r", R"({"state":"online","mesh":"thread"})");
  hear("g/numbers",
       R"({"robots":{"r":{"last_heard":"2026-11-21T13:57:43.500Z","mesh":"thread"}}})");
  const auto is_heard_at = [&](const char* time) {
    return has(
        R"(slamgw_robot_last_heard_timestamp_seconds{gateway="g",robot="r",mesh="thread"} )" +
        std::string(time));
  };
  hear_robot("g", "2026-11-21T13:57:49.250Z");
  EXPECT_TRUE(is_heard_at("1795269469.25")) << text();
  hear_robot("g", "2026-11-21T13:57:40Z");
  EXPECT_TRUE(is_heard_at("1795269463.5")) << "an old message from the store";
  hear_robot("another", "2026-11-21T13:57:49.250Z");
  EXPECT_TRUE(is_heard_at("1795269463.5")) << "that gateway is unknown";
  hear_robot("", "");
  EXPECT_TRUE(is_heard_at("1795269500")) << "the time of receipt";
  hear("g/robots/r", R"({"state":"offline","mesh":"thread"})");
  EXPECT_TRUE(is_heard_at("1795269463.5")) << "a last will does not count as heard";
}

TEST_F(WebMetrics, ShowOnlyAbsenceOfGoneGateway) {
  hear("g/state", R"({"state":"offline"})");
  hear("g/stats", R"({"uptime_s":12})");
  hear("g/numbers", R"({"robots":{"r":{"up":70}}})");
  EXPECT_TRUE(has(R"(slamgw_gateway_up{gateway="g"} 0)"));
  EXPECT_EQ(text().find("uptime"), std::string::npos);
  EXPECT_EQ(text().find("slamgw_robot_"), std::string::npos);
}

TEST_F(WebMetrics, ShowClockOffsetAndCorrectTimesByIt) {
  hear("g/state", R"({"state":"online","since":"2026-11-21T16:58:20Z"})");
  hear("g/robots/r", R"({"state":"online","mesh":"ble","last_seen":"2026-11-21T16:58:20Z"})");
  hear("g/numbers", R"({"robots":{"r":{"mesh":"ble","last_heard":"2026-11-21T16:58:20Z"}}})");
  EXPECT_TRUE(has(R"(slamgw_gateway_clock_ahead_seconds{gateway="g"} 10800)")) << text();
  EXPECT_TRUE(has(
      R"(slamgw_robot_last_heard_timestamp_seconds{gateway="g",robot="r",mesh="ble"} 1795269500)"))
      << text();
}

TEST_F(WebMetrics, EscapeNamesOfRobots) {
  hear("g/numbers", R"({"robots":{"a\"b\\c\nd":{"meshes":{"ble":{"up":1}}}}})");
  EXPECT_TRUE(has(
      R"(slamgw_robot_messages_total{gateway="g",robot="a\"b\\c\nd",mesh="ble",direction="up"} 1)"));
}

TEST_F(WebMetrics, IgnoreInvalidDocuments) {
  for (const char* payload : {"", "x", "[]", "1", R"({"robots":[1]})", R"({"robots":{"r":5}})",
                              R"({"robots":{"r":{"up":"many","last_heard":7}}})",
                              R"({"messages":[],"meshes":4,"broker":null})",
                              R"({"meshes":{"ble":{"latency":5},"thread":[]}})",
                              R"({"meshes":{"ble":{"latency":{"count":1,"sum_us":2,
                                  "buckets":[5,{"le_us":"x","count":1}]}}}})",
                              R"({"robots":{"r":{"meshes":{"ble":[1],"x":{"up":"y"}}}}})"}) {
    hear("g/state", payload);
    hear("g/stats", payload);
    hear("g/numbers", payload);
    hear("g/robots/r", payload);
    EXPECT_NE(text().find("slamgw_web_info"), std::string::npos) << payload;
    outcomes.add("g", payload);
  }
  EXPECT_EQ(outcomes.of("g"), OutcomeCounts::Counts{});
}

/// Prometheus refuses a scrape, or takes it for a restart, when a gateway publishes such numbers.
TEST_F(WebMetrics, LeaveOutNegativeCountersAndBrokenHistograms) {
  const auto stats = [this](const std::string& latency) {
    hear("g/state", R"({"state":"online"})");
    hear("g/stats",
         R"({"messages":{"published":-1,"dropped":2,"up":-5},"meshes":{"ble":{"state":"up",
                        "messages":{"up":-3},"latency":)" +
             latency + "}}}");
    return text();
  };
  const std::string good =
      stats(R"({"count":3,"sum_us":9,"buckets":[{"le_us":1,"count":1},{"le_us":2,"count":1}]})");
  EXPECT_NE(good.find("slamgw_latency_seconds_count"), std::string::npos);
  EXPECT_NE(good.find("slamgw_gateway_dropped_messages_total"), std::string::npos);
  EXPECT_EQ(good.find("slamgw_gateway_published_messages_total"), std::string::npos);
  EXPECT_EQ(good.find("} -"), std::string::npos) << good;
  for (const char* const broken :
       {R"({"count":3,"sum_us":9,"buckets":[{"le_us":2,"count":1},{"le_us":2,"count":1}]})",
        R"({"count":3,"sum_us":9,"buckets":[{"le_us":2,"count":1},{"le_us":1,"count":1}]})",
        R"({"count":3,"sum_us":9,"buckets":[{"le_us":1,"count":2},{"le_us":2,"count":1}]})",
        R"({"count":3,"sum_us":9,"buckets":[{"le_us":1,"count":4}]})",
        R"({"count":3,"sum_us":9,"buckets":[{"le_us":1,"count":-4}]})",
        R"({"count":-1,"sum_us":9,"buckets":[]})", R"({"count":1,"sum_us":-9,"buckets":[]})"})
    EXPECT_EQ(stats(broken).find("slamgw_latency_seconds"), std::string::npos) << broken;
}

TEST_F(WebMetrics, ShowEachOfThousandRobots) {
  hear("g/state", R"({"state":"online"})");
  for (int i = 0; i < 1000; ++i)
    hear("g/robots/r" + std::to_string(i), R"({"state":"online","mesh":"ble"})");
  EXPECT_TRUE(has(R"(slamgw_robot_online{gateway="g",robot="r999",mesh="ble"} 1)"));
  EXPECT_TRUE(has("slamgw_web_left_out_samples 0"));
}

/// Names come from the broker; any client that may publish there can make many and long ones.
TEST(WebExposition, LeavesOutSamplesBeyondItsBound) {
  Exposition out;
  const std::string name(1 << 20, 'x');
  for (int i = 0; i < 26; ++i) out.add("slamgw_x", "X.", {{"robot", name}}, i);
  EXPECT_GT(out.left_out(), 0u);
  EXPECT_LT(out.text().size(), Exposition::max_bytes + name.size() + 1000);
}

TEST_F(WebMetrics, CountKnownOutcomesOfKnownGatewaysFromZero) {
  hear("g/state", R"({"state":"online"})");
  EXPECT_TRUE(has(R"(slamgw_commands_total{gateway="g",outcome="timeout"} 0)")) << text();
  outcomes.add("g", R"({"outcome":"delivered"})");
  outcomes.add("g", R"({"outcome":"delivered"})");
  EXPECT_TRUE(has(R"(slamgw_commands_total{gateway="g",outcome="delivered"} 2)"));
  outcomes.add("g", R"({"outcome":"made up"})");
  EXPECT_EQ(text().find("made up"), std::string::npos);
  for (std::size_t i = 0; i < 2 * OutcomeCounts::max_gateways; ++i)
    outcomes.add(std::to_string(i), R"({"outcome":"sent"})");
  EXPECT_EQ(outcomes.of(std::to_string(OutcomeCounts::max_gateways))[1], 0u) << "bounded";
  EXPECT_EQ(outcomes.of("0")[1], 1u);
  outcomes.add("g", R"({"outcome":"delivered"})");
  EXPECT_TRUE(has(R"(slamgw_commands_total{gateway="g",outcome="delivered"} 3)"));
  EXPECT_EQ(text().find(R"(slamgw_commands_total{gateway="0")"), std::string::npos);
}

}  // namespace
}  // namespace slamgw::web::test
