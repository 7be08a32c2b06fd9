// SPDX-License-Identifier: Apache-2.0
// Upstream, robots of both meshes look alike. The same robots on either mesh publish the same
// payloads on the same topics, and the same commands reach them.
#include <gtest/gtest.h>

#include <signal.h>

#include <algorithm>
#include <map>
#include <set>
#include <sstream>

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

TEST_P(EndToEnd, RobotsPublishTheSameOnEitherMesh) {
  const Heard thread = hear(GetParam(), thread_arguments);
  const Heard ble = hear(GetParam(), ble_arguments);
  EXPECT_EQ(thread.lines, ble.lines);
  EXPECT_EQ(thread.report["lost"], 0) << thread.report;
  EXPECT_EQ(ble.report["lost"], 0) << ble.report;
  EXPECT_EQ(thread.report["sent"], ble.report["sent"]);

  const std::set<std::string> different(thread.lines.begin(), thread.lines.end());
  EXPECT_GT(different.size(), static_cast<std::size_t>(robots * updates / 2))
      << "robots that rest would make the comparison weak";
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

TEST_P(EndToEnd, CommandsReachRobotOnEitherMesh) {
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

// --- Updates of other robots ---------------------------------------------------------------------

/// CRC-16/CCITT-FALSE of the ids, as Python's binascii.crc_hqx(id, 0xffff) says.
const std::map<std::string, std::string> number_of_far_robot{
    {"far1", "0x1e99"}, {"far2", "0x2efa"}, {"far3", "0x3edb"}};

/// Pairs of a robot's number and a payload, sorted.
using Sayings = std::vector<std::pair<std::string, std::string>>;

/// Returns updates of far robots that `listener` received, by the simulator's `--record`.
Sayings heard_by(const std::string& listener, const std::string& record) {
  Sayings sayings;
  std::istringstream lines(read_file(record));
  for (std::string line; std::getline(lines, line);) {
    std::istringstream words(line);
    std::string what;
    std::string robot;
    std::string sender;
    std::string payload;
    words >> what >> robot >> sender >> payload;
    for (const auto& [id, number] : number_of_far_robot)
      if (what == "heard" && robot == listener && (sender == id || sender == number))
        sayings.emplace_back(number, payload);
  }
  std::ranges::sort(sayings);
  return sayings;
}

std::uint64_t ble_counter(const GatewayProcess& gateway, const char* name) {
  return gateway.ctl({"status"})["meshes"]["ble"]["counters"].value(name, std::uint64_t{0});
}

std::uint64_t relayed_or_superseded(const GatewayProcess& gateway) {
  return ble_counter(gateway, "relayed") + ble_counter(gateway, "relays_superseded");
}

json relaying_configuration(const BrokerOfVersion& broker) {
  return {
      {"broker", {{"uri", broker.link_uri()}}},
      {"ble_mesh", {{"enabled", true}, {"relay", {"robot/+/update"}}}},
      {"robots",
       {{{"id", "near1"}, {"ble_address", 0x0100}}, {{"id", "near2"}, {"ble_address", 0x0101}}}}};
}

TEST_P(EndToEnd, RobotsOnEitherMeshReceiveTheSameUpdatesOfOthers) {
  BrokerOfVersion broker(GetParam());
  GatewayProcess gateway(relaying_configuration(broker));
  SimulatorProcess near({"ble", "--tty", gateway.tty(), "--unprovisioned", "--robots", "2",
                         "--id-prefix", "near", "--rate", "1", "--record", gateway / "near"});
  ASSERT_TRUE(eventually([&] {
    return gateway.logs("near1 is configured") && gateway.logs("near2 is configured");
  })) << gateway.log();
  // Publishes once in a quarter of an hour, in one segment like all updates of the far robots.
  SimulatorProcess ear({"thread", "--gateway", gateway.mqttsn_address(), "--hear", "--robots", "1",
                        "--id-prefix", "ear", "--rate", "0.001", "--max-obstacles", "0", "--record",
                        gateway / "ear"});
  const auto hears = [](const std::string& record) {
    return read_file(record).find("heard ear1 near") != std::string::npos;
  };
  ASSERT_TRUE(eventually([&] {
    return hears(gateway / "ear") && relayed_or_superseded(gateway) == 1;
  })) << gateway.log();
  SimulatorProcess far({"thread", "--gateway", gateway.mqttsn_address(), "--robots", "3",
                        "--id-prefix", "far", "--seed", "7", "--rate", "1", "--messages", "6",
                        "--max-obstacles", "0"});
  EXPECT_EQ(far.report()["acknowledged"], 18);
  EXPECT_TRUE(eventually([&] {
    return relayed_or_superseded(gateway) >= 19 && heard_by("ear1", gateway / "ear").size() >= 18;
  })) << gateway.ctl({"status"});
  near.process().send_signal(SIGTERM);
  const json listened = near.report();

  const Sayings on_thread = heard_by("ear1", gateway / "ear");
  const bool is_complete = ble_counter(gateway, "relays_superseded") == 0;
  for (const std::string robot : {"near1", "near2"}) {
    const Sayings on_ble = heard_by(robot, gateway / "near");
    EXPECT_TRUE(std::ranges::includes(on_thread, on_ble)) << listened;
    // Otherwise the computer was busy for longer than the second between two updates.
    if (is_complete) {
      EXPECT_EQ(on_ble, on_thread);
    }
    for (const auto& [id, number] : number_of_far_robot)
      EXPECT_TRUE(listened["robots"][robot]["heard"].contains(number)) << listened;
  }
  EXPECT_EQ(relayed_or_superseded(gateway), 19u) << "robots of the mesh are not echoed";
  EXPECT_EQ(ble_counter(gateway, "relays_dropped"), 0u);
}

/// The other robot needs no mesh here: the broker has its updates.
TEST_P(EndToEnd, BleRobotsReceiveUpdatesFromAnotherGateway) {
  BrokerOfVersion broker(GetParam());
  const auto say = [&](const std::string& robot, const std::string& update, bool is_kept) {
    std::vector<std::string> arguments{"-q", "1",   "-t", "ntnu-slam/robot/" + robot + "/update",
                                       "-m", update};
    if (is_kept) arguments.push_back("-r");
    mosquitto_publish(broker, arguments);
  };
  say("far1", "KEPT", true);
  GatewayProcess gateway(relaying_configuration(broker));
  SimulatorProcess near({"ble", "--tty", gateway.tty(), "--robots", "2", "--id-prefix", "near",
                         "--rate", "1", "--record", gateway / "near"});
  ASSERT_TRUE(eventually([&] { return gateway.logs("near2 update"); })) << gateway.log();
  ASSERT_TRUE(eventually([&] {                        // until the subscription stands
    say("far3", "four octets and four more", false);  // not an update
    return ble_counter(gateway, "relays_dropped") > 0;
  }));
  say("near1", "SELF", false);
  say("far2", "ONE.", false);
  const Sayings expected{{number_of_far_robot.at("far2"), "4f4e452e"}};
  EXPECT_TRUE(eventually([&] { return heard_by("near2", gateway / "near") == expected; }))
      << read_file(gateway / "near");
  near.process().send_signal(SIGTERM);
  EXPECT_EQ(near.report()["robots"]["near1"]["heard"], (json{{"0x2efa", 1}}));
}

}  // namespace
}  // namespace slamgw::test
