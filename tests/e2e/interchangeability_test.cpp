// SPDX-License-Identifier: Apache-2.0
// Whoever listens upstream cannot tell which mesh a robot is on: the same robots on either mesh say
// the same things on the same topics, and the same commands reach them.
#include <gtest/gtest.h>

#include <signal.h>

#include <algorithm>
#include <set>

#include "tests/e2e/gateway_process.hpp"
#include "tests/support/broker_of_version.hpp"
#include "tests/support/eventually.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;

constexpr int robots = 3;
constexpr int updates = 20;
const std::vector<std::string> world{"--robots", "3",  "--messages", "20",
                                     "--rate",   "25", "--seed",     "7"};

json configuration(const BrokerOfVersion& broker) {
  json out{{"broker", {{"uri", broker.link_uri()}}},
           {"ble_mesh", {{"enabled", true}}},
           {"robots", json::array()}};
  for (int n = 1; n <= robots; ++n) {
    const std::string id = "robot" + std::to_string(n);
    out["robots"].push_back(
        {{"id", id}, {"ble_address", 0x0100 + n - 1}, {"mqttsn_client_id", id}});
  }
  return out;
}

std::vector<std::string> thread_arguments(const GatewayProcess& gateway) {
  std::vector<std::string> arguments{"thread", "--gateway", gateway.mqttsn_address()};
  arguments.insert(arguments.end(), world.begin(), world.end());
  return arguments;
}

std::vector<std::string> ble_arguments(const GatewayProcess& gateway) {
  std::vector<std::string> arguments{"ble", "--tty", gateway.tty(), "--acknowledged"};
  arguments.insert(arguments.end(), world.begin(), world.end());
  return arguments;
}

struct Heard {
  json report;
  std::vector<std::string> lines;  // sorted topic and payload
};

template <class ArgumentsOf>
Heard hear(MqttVersion version, ArgumentsOf arguments_of) {
  BrokerOfVersion broker(version);
  Subscriber subscriber(broker, "ntnu-slam/robot/#");
  GatewayProcess gateway(configuration(broker));
  SimulatorProcess simulator(arguments_of(gateway));
  Heard heard{simulator.report(), {}};
  constexpr std::size_t expected = robots * (updates + 1);  // and one adv each
  EXPECT_TRUE(eventually([&] { return subscriber.lines().size() >= expected; }))
      << subscriber.lines().size() << " messages\n"
      << gateway.log() << simulator.errors();
  heard.lines = subscriber.lines();
  std::sort(heard.lines.begin(), heard.lines.end());
  return heard;
}

class EndToEnd : public testing::TestWithParam<MqttVersion> {};
INSTANTIATE_TEST_SUITE_P(Over, EndToEnd, either_version, OverEitherVersion::name);

TEST_P(EndToEnd, TheSameRobotsSayTheSameOnEitherMesh) {
  const Heard thread = hear(GetParam(), thread_arguments);
  const Heard ble = hear(GetParam(), ble_arguments);
  EXPECT_EQ(thread.lines, ble.lines);
  EXPECT_EQ(thread.report["lost"], 0) << thread.report;
  EXPECT_EQ(ble.report["lost"], 0) << ble.report;
  EXPECT_EQ(thread.report["sent"], ble.report["sent"]);

  const std::set<std::string> different(thread.lines.begin(), thread.lines.end());
  EXPECT_GT(different.size(), static_cast<std::size_t>(robots * updates / 2))
      << "the robots move, so the comparison means something";
}

void expect_command_reaches_robot(std::vector<std::string> arguments, GatewayProcess& gateway,
                                  const Mosquitto& broker) {
  Subscriber outcomes(broker, "ntnu-slam/gateway/test/commands/#", "%t %p");
  SimulatorProcess simulator(arguments);
  ASSERT_TRUE(eventually([&] { return gateway.logs("robot1 update"); })) << gateway.log();
  // x = 10 cm, y = -20 cm; the last two octets are above 0x7f, so the payload goes through a file.
  write_file(gateway / "payload", std::string("\x0a\x00\xec\xff", 4));
  mosquitto_publish(broker,
                    {"-q", "1", "-t", "ntnu-slam/server/robot1/cmd", "-f", gateway / "payload"});
  mosquitto_publish(broker, {"-q", "1", "-t", "ntnu-slam/server/robot1/run", "-m", "stop"});
  ASSERT_TRUE(eventually([&] { return outcomes.lines().size() >= 2; })) << gateway.log();
  for (const std::string& line : outcomes.lines()) {
    EXPECT_TRUE(line.starts_with("ntnu-slam/gateway/test/commands/robot1 ")) << line;
    EXPECT_EQ(json::parse(line.substr(line.find('{')))["outcome"], "delivered") << line;
  }
  simulator.process().send_signal(SIGTERM);
  EXPECT_EQ(simulator.report()["robots"]["robot1"]["commands_received"], 2);
}

TEST_P(EndToEnd, TheSameCommandsReachARobotOnEitherMesh) {
  for (const bool is_ble : {false, true}) {
    SCOPED_TRACE(is_ble ? "BLE Mesh" : "Thread");
    BrokerOfVersion broker(GetParam());
    GatewayProcess gateway(configuration(broker));
    std::vector<std::string> arguments{"--robots", "1", "--seed", "3"};
    if (is_ble) {
      arguments.insert(arguments.begin(), {"ble", "--tty", gateway.tty()});
    } else {
      arguments.insert(arguments.begin(), {"thread", "--gateway", gateway.mqttsn_address()});
    }
    expect_command_reaches_robot(arguments, gateway, broker);
  }
}

}  // namespace
}  // namespace slamgw::test
