// SPDX-License-Identifier: Apache-2.0
// Robots in Home Assistant: what the daemon publishes at a real Mosquitto with
// `topics.home_assistant`, read by tests/e2e/home_assistant.py as Home Assistant would.
#include <gtest/gtest.h>
#include <signal.h>

#include <algorithm>
#include <string>

#include "tests/e2e/gateway_process.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/mosquitto.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;

class HomeAssistantShows : public testing::TestWithParam<const char*> {
 protected:
  json configuration() const {
    return {{"broker", {{"uri", broker.uri()}}},
            {"topics", {{"home_assistant", true}}},
            {"payload", {{"update", GetParam()}}},
            {"robots", {{{"id", "lego_1"}, {"mqttsn_client_id", "robot1"}}}},
            {"ble_mesh", {{"enabled", true}}}};
  }
  /// Returns devices and the states of their entities after all messages so far.
  json shown() const {
    std::string text;
    for (const std::string& line : messages.lines()) text += line + "\n";
    write_file(directory / "messages", text);
    const Finished read = run_program({SLAMGW_HOME_ASSISTANT, directory / "messages"});
    EXPECT_EQ(read.status, 0) << read.err;
    return json::parse(read.out, nullptr, false);
  }
  bool shows(const char* robot, const char* entity, const json& state) const {
    return shown().value(robot, json::object()).value(entity, json()) == state;
  }
  /// Returns the number of messages so far on a topic.
  std::ptrdiff_t count(const std::string& topic_and_space) const {
    return std::ranges::count_if(messages.lines(), [&](const std::string& line) {
      return line.starts_with(topic_and_space);
    });
  }
  /// A coordinate of the simulator's robots, in centimetres.
  bool shows_coordinates(const char* robot) const {
    const json device = shown().value(robot, json::object());
    const auto is_in_ring = [&](const char* entity) {
      const std::string state = device.value(entity, "unknown");
      return state.find_first_not_of("-0123456789") == state.npos && std::stoi(state) >= -80 &&
             std::stoi(state) <= 80;
    };
    return is_in_ring("X") && is_in_ring("Y");
  }

  Mosquitto broker;
  Subscriber messages{broker, "#"};
  TempDir directory;
};
INSTANTIATE_TEST_SUITE_P(With, HomeAssistantShows, testing::Values("positions", "json"),
                         [](const auto& mode) { return std::string(mode.param); });

constexpr const char* document = "homeassistant/device/ntnu-slam/ble-0100/config ";

TEST_P(HomeAssistantShows, RobotsOfBothMeshes) {
  GatewayProcess gateway(configuration());
  SimulatorProcess thread({"thread", "--gateway", gateway.mqttsn_address(), "--robots", "1"});
  SimulatorProcess ble({"ble", "--tty", gateway.tty(), "--robots", "1"});
  for (const char* robot : {"lego_1", "ble-0100"})
    ASSERT_TRUE(eventually([&] { return shows_coordinates(robot); })) << shown() << gateway.log();
  EXPECT_EQ(shown()["lego_1"]["Presence"], "on");
  EXPECT_FALSE(shown()["lego_1"].contains("Signal")) << "Thread reports no signal";
  ASSERT_TRUE(eventually([&] { return shown()["ble-0100"].contains("Signal"); })) << shown();
  EXPECT_LT(std::stoi(shown()["ble-0100"]["Signal"].get<std::string>()), 0);

  const json button = shown()["lego_1"]["Stop"];
  mosquitto_publish(broker, {"-q", "1", "-t", button.items().begin().key(), "-m",
                             button.items().begin().value()});
  EXPECT_TRUE(eventually([&] { return count("ntnu-slam/gateway/test/commands/lego_1 ") == 1; }));

  thread.process().send_signal(SIGTERM);
  EXPECT_EQ(thread.report()["robots"]["robot1"]["commands_received"], 1);
  EXPECT_TRUE(eventually([&] { return shows("lego_1", "Presence", "off"); })) << shown();
  EXPECT_TRUE(shows("lego_1", "X", "unavailable"));
  EXPECT_FALSE(gateway.ctl({"forget", "lego_1"}).is_null());
  EXPECT_TRUE(eventually([&] { return !shown().contains("lego_1"); })) << shown();

  gateway.process().send_signal(SIGTERM);
  EXPECT_TRUE(eventually([&] { return shows("ble-0100", "Presence", "unavailable"); })) << shown();
  const auto before = count(document);
  gateway.start();
  EXPECT_TRUE(eventually([&] { return count(document) > before; })) << gateway.log();
  EXPECT_TRUE(eventually([&] { return shows("ble-0100", "Presence", "on"); })) << shown();
  gateway.reload([](json& wanted) { wanted["topics"]["home_assistant"] = false; });
  EXPECT_TRUE(eventually([&] { return shown().empty(); })) << shown();
}

/// A robot, or an operator, clears a retained `update` with an empty message.
TEST_P(HomeAssistantShows, UnknownPositionAfterItWasCleared) {
  GatewayProcess gateway(configuration());
  SimulatorProcess thread({"thread", "--gateway", gateway.mqttsn_address(), "--robots", "1",
                           "--messages", "1", "--linger-s", "600"});
  ASSERT_TRUE(eventually([&] { return shows_coordinates("lego_1"); })) << shown() << gateway.log();
  mosquitto_publish(broker, {"-q", "1", "-r", "-t", "ntnu-slam/robot/lego_1/update", "-n"});
  EXPECT_TRUE(eventually([&] { return shows("lego_1", "X", "unknown"); })) << shown();
  EXPECT_TRUE(shows("lego_1", "Y", "unknown"));
}

}  // namespace
}  // namespace slamgw::test
