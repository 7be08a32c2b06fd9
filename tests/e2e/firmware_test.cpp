// SPDX-License-Identifier: Apache-2.0
// firmware/examples/thread_robot.c, a robot on slam_mqttsn.h, against the daemon and a real broker.
#include <gtest/gtest.h>

#include <signal.h>

#include <algorithm>

#include "tests/e2e/gateway_process.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/mosquitto.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;

class FirmwareRobot {
 public:
  explicit FirmwareRobot(const GatewayProcess& gateway, const std::string& id) {
    const std::string address = gateway.mqttsn_address();
    const std::size_t colon = address.find(':');
    process_ = std::make_unique<ChildProcess>(
        std::vector<std::string>{SLAMGW_THREAD_ROBOT, address.substr(0, colon),
                                 address.substr(colon + 1), id},
        directory_ / "out", directory_ / "err");
  }
  bool says(const std::string& line) const { return count(line) > 0; }
  int count(const std::string& line) const {
    const std::string all = "\n" + read_file(directory_ / "out");
    int found = 0;
    for (std::size_t at = 0; (at = all.find("\n" + line + "\n", at)) != std::string::npos; ++at)
      ++found;
    return found;
  }
  std::string output() const {
    return read_file(directory_ / "out") + read_file(directory_ / "err");
  }
  void kill() { process_->send_signal(SIGKILL); }

 private:
  TempDir directory_;
  std::unique_ptr<ChildProcess> process_;
};

class FirmwareEndToEnd : public testing::Test {
 protected:
  FirmwareEndToEnd()
      : robots(broker, "ntnu-slam/robot/#"),
        outcomes(broker, "ntnu-slam/gateway/test/commands/#", "%t %p"),
        gateway(json{{"broker", {{"uri", broker.uri()}}}}),
        robot(gateway, "fw-1") {}

  bool has_line(const Subscriber& subscriber, std::string_view text) const {
    return std::ranges::any_of(subscriber.lines(), [&](const std::string& line) {
      return line.find(text) != std::string::npos;
    });
  }

  Mosquitto broker;
  Subscriber robots;
  Subscriber outcomes;
  GatewayProcess gateway;
  FirmwareRobot robot;
};

TEST_F(FirmwareEndToEnd, PublishesExecutesCommandsAndLeavesItsWill) {
  ASSERT_TRUE(eventually([&] { return robots.lines().size() >= 3; }))
      << gateway.log() << robot.output();
  EXPECT_EQ(robots.lines()[0], "ntnu-slam/robot/fw-1/update 1c001c0046004600");
  ASSERT_TRUE(eventually([&] { return robot.says("ready"); }));

  write_file(gateway / "payload", std::string("\x0a\x00\xec\xff", 4));
  mosquitto_publish(broker,
                    {"-q", "1", "-t", "ntnu-slam/server/fw-1/cmd", "-f", gateway / "payload"});
  for (const auto* word : {"stop", "unpause"})
    mosquitto_publish(broker, {"-q", "1", "-t", "ntnu-slam/server/fw-1/run", "-m", word});
  ASSERT_TRUE(eventually([&] { return outcomes.lines().size() >= 3; })) << gateway.log();
  for (const std::string& line : outcomes.lines())
    EXPECT_EQ(json::parse(line.substr(line.find('{')))["outcome"], "delivered") << line;
  EXPECT_TRUE(eventually([&] {
    return robot.says("cmd 10 -20") && robot.says("run 0") && robot.says("run 1");
  })) << robot.output();

  robot.kill();
  EXPECT_TRUE(eventually([&] { return has_line(robots, "ntnu-slam/robot/fw-1/will 6c6f7374"); }))
      << gateway.log();
}

/// The daemon keeps sessions over a restart, so the test deletes the store: the robot has no
/// session then and must send CONNECT.
TEST_F(FirmwareEndToEnd, ReconnectsToGatewayThatLostItsSession) {
  ASSERT_TRUE(eventually([&] { return robot.says("ready"); })) << gateway.log() << robot.output();
  gateway.process().send_signal(SIGTERM);
  gateway.process().wait();
  gateway.configure([&](json& all) { all["store"]["directory"] = gateway / "another-store"; });
  gateway.start();
  ASSERT_TRUE(eventually([&] { return robot.count("ready") >= 2; })) << robot.output();
  EXPECT_TRUE(robot.says("the gateway is lost"));
  const std::size_t before = robots.lines().size();
  EXPECT_TRUE(eventually([&] { return robots.lines().size() >= before + 3; })) << gateway.log();
}

}  // namespace
}  // namespace slamgw::test
