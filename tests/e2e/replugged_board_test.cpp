// SPDX-License-Identifier: Apache-2.0
// Nordic's stock board forgets its keys, addresses and sequence number at each restart. Robots
// exchange messages with the gateway again nevertheless.
#include <gtest/gtest.h>
#include <signal.h>

#include <chrono>
#include <iostream>
#include <map>
#include <sstream>

#include "tests/e2e/gateway_process.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/mosquitto.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;
using Clock = std::chrono::steady_clock;

constexpr std::size_t robots_in_traffic = 10;
/// The first restart follows a normal start, the others follow a restart.
constexpr int times = 3;
/// Longest time for ten robots to return; they usually need a quarter of it.
constexpr std::chrono::seconds rejoin_limit{60};
/// Acknowledgements that each robot must receive: one may have been in flight.
constexpr unsigned again = 3;
/// Acknowledgements with segments: without working ones, 8 updates succeed within `patience`.
constexpr unsigned often = 15;

class RepluggedBoard : public testing::Test {
 protected:
  /// `more` chooses the updates. Updates of 9 octets and more are segmented, so robots need the
  /// board's acknowledgements of segments, too.
  void join(const std::vector<std::string>& more) {
    std::vector<std::string> arguments{"ble",
                                       "--tty",
                                       gateway.tty(),
                                       "--unprovisioned",
                                       "--robots",
                                       std::to_string(robots_in_traffic),
                                       "--acknowledged",
                                       "--segment-timing",
                                       "--rate",
                                       "2",
                                       "--record",
                                       record};
    arguments.insert(arguments.end(), more.begin(), more.end());
    simulator.emplace(arguments);
    ASSERT_TRUE(eventually([&] { return is_each_acknowledged({}, again); }, rejoin_limit))
        << gateway.log() << simulator->errors();
  }
  /// Returns the number of acknowledged updates by robot.
  std::map<std::string, unsigned> acknowledged() const {
    std::map<std::string, unsigned> counts;
    std::istringstream lines(read_file(record));
    for (std::string line; std::getline(lines, line);) {
      std::istringstream words(line);
      std::string what;
      std::string robot;
      if (words >> what >> robot && what == "acknowledged") ++counts[robot];
    }
    return counts;
  }
  bool is_each_acknowledged(const std::map<std::string, unsigned>& before, unsigned more) const {
    const auto now = acknowledged();
    if (now.size() < robots_in_traffic) return false;
    for (const auto& [robot, count] : now) {
      const auto known = before.find(robot);
      if (count < (known == before.end() ? 0 : known->second) + more) return false;
    }
    return true;
  }
  std::size_t printed(const std::string& what) const {
    const std::string all = simulator->errors();
    std::size_t count = 0;
    for (auto at = all.find(what); at != std::string::npos; at = all.find(what, at + 1)) ++count;
    return count;
  }
  /// Sends the signal, waits for the simulator to print `sign`, and then for all robots.
  void expect_all_again(int signal, const std::string& sign, unsigned updates = again) {
    const std::size_t before = printed(sign);
    simulator->process().send_signal(signal);
    ASSERT_TRUE(eventually([&] { return printed(sign) > before; })) << simulator->errors();
    const auto begin = Clock::now();
    const auto counts = acknowledged();
    ASSERT_TRUE(eventually([&] { return is_each_acknowledged(counts, updates); }))
        << gateway.log() << simulator->errors() << gateway.ctl({"status"});
    const std::chrono::duration<double> took = Clock::now() - begin;
    std::cout << sign << ": " << took.count() << " s until all " << robots_in_traffic
              << " robots were acknowledged " << updates << " times\n";
  }

  Mosquitto broker;
  GatewayProcess gateway{
      json{{"broker", {{"uri", broker.uri()}}},
           {"ble_mesh", {{"enabled", true}, {"provisioning", {{"enabled", true}}}}}}};
  const std::string record = gateway / "record";
  std::optional<SimulatorProcess> simulator;
};

const std::vector<std::string> short_updates{"--max-obstacles", "0"};
const std::vector<std::string> segmented_updates{"--payload", "full"};

TEST_F(RepluggedBoard, RestoresTrafficOfAllRobotsEachTime) {
  join(short_updates);
  for (int round = 0; round < times && !HasFatalFailure(); ++round)
    expect_all_again(SIGUSR1, "the board is back");
  if (HasFatalFailure()) return;
  const json robots = gateway.ctl({"robots"});
  ASSERT_EQ(robots.size(), robots_in_traffic) << robots;
  for (const json& robot : robots)
    EXPECT_EQ(gateway.ctl({"send", robot["id"], "cmd", "10,-20"})["outcome"], "delivered") << robot;
}

TEST_F(RepluggedBoard, RestoresSegmentAcknowledgementsForAllRobots) {
  join(segmented_updates);
  for (int round = 0; round < times && !HasFatalFailure(); ++round)
    expect_all_again(SIGUSR1, "the board is back", often);
}

/// The board's start event is lost, then follows half an event, then comes whole as after Radio
/// Reset.
TEST_F(RepluggedBoard, RestoresTrafficAfterRestartsBehindOpenPort) {
  join(short_updates);
  for (int round = 0; round < times && !HasFatalFailure(); ++round)
    expect_all_again(SIGUSR2, "the board restarts");
}

}  // namespace
}  // namespace slamgw::test
