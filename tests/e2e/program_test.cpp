// SPDX-License-Identifier: Apache-2.0
// The command lines of the manual pages: what the programs print and with which status they end.
#include <gtest/gtest.h>
#include <signal.h>

#include <set>
#include <string>

#include "tests/e2e/gateway_process.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/mosquitto.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;

TEST(Programs, PrintTheirVersionAndHelp) {
  for (const char* program : {SLAMGW_DAEMON, SLAMGW_CTL, SLAMGW_SIM}) {
    const Finished version = run_program({program, "--version"});
    EXPECT_EQ(version.status, 0) << program;
    EXPECT_NE(version.out.find(" " SLAMGW_VERSION "\n"), std::string::npos) << version.out;
    const Finished help = run_program({program, "--help"});
    EXPECT_EQ(help.status, 0) << program;
    EXPECT_FALSE(help.out.empty());
  }
}

TEST(Programs, RefuseUnknownArguments) {
  for (const char* program : {SLAMGW_DAEMON, SLAMGW_CTL, SLAMGW_SIM}) {
    const Finished finished = run_program({program, "--no-such-option"});
    EXPECT_EQ(finished.status, 2) << program;
    EXPECT_NE(finished.err.find("--help"), std::string::npos) << program << finished.err;
  }
}

TEST(Programs, FailWhenTheirOutputIsLost) {
  for (const char* program : {SLAMGW_DAEMON, SLAMGW_CTL, SLAMGW_SIM}) {
    for (const char* to : {">/dev/full", ">&-"}) {
      const std::string lost = std::string("exec \"$@\" ") + to;
      const Finished finished = run_program({"sh", "-c", lost, "sh", program, "--version"});
      EXPECT_EQ(finished.status, 1) << program << to;
      EXPECT_NE(finished.err.find(": standard output: "), std::string::npos) << finished.err;
    }
  }
}

TEST(Daemon, PrintsAndAcceptsShippedConfiguration) {
  const Finished printed = run_program({SLAMGW_DAEMON, "--print-config"});
  EXPECT_EQ(printed.status, 0);
  EXPECT_EQ(printed.out, read_file(SLAMGW_DEFAULT_CONFIG));
  const Finished checked =
      run_program({SLAMGW_DAEMON, "--config", SLAMGW_DEFAULT_CONFIG, "--check-config"});
  EXPECT_EQ(checked.status, 0) << checked.out;
  EXPECT_EQ(checked.out, "OK\n");
}

TEST(Daemon, FailsWhenItsOutputIsLost) {
  for (const char* option : {"--print-config", "--check-config", "--version"}) {
    const Finished finished =
        run_program({"sh", "-c", "exec \"$@\" >/dev/full", "sh", SLAMGW_DAEMON, "--config",
                     SLAMGW_DEFAULT_CONFIG, option});
    EXPECT_EQ(finished.status, 1) << option;
    EXPECT_EQ(finished.err, "slam-gatewayd: standard output: No space left on device\n");
  }
}

TEST(Daemon, NamesEveryProblemOfConfigurationAndExits78) {
  const TempDir directory;
  const std::string file = directory / "gateway.json";
  write_file(file, "{\n  \"broker\": {\"urii\": \"x\"},\n  \"mqttsn\": {\"gateway_id\": 0}\n}\n");
  const Finished checked = run_program({SLAMGW_DAEMON, "--config", file, "--check-config"});
  EXPECT_EQ(checked.status, 78);
  EXPECT_NE(checked.out.find(file + ":2: broker.urii: "), std::string::npos) << checked.out;
  EXPECT_NE(checked.out.find("uri"), std::string::npos);
  EXPECT_NE(checked.out.find(file + ":3: mqttsn.gateway_id: "), std::string::npos) << checked.out;
  EXPECT_EQ(run_program({SLAMGW_DAEMON, "--config", file}).status, 78);
  EXPECT_EQ(run_program({SLAMGW_DAEMON, "--config", directory / "none.json"}).status, 78);
}

TEST(Daemon, PublishesOnlineAndOfflineRetained) {
  Mosquitto broker;
  Subscriber subscriber(broker, "ntnu-slam/gateway/test/state", "%p");
  GatewayProcess gateway(json{{"broker", {{"uri", broker.uri()}}}});
  ASSERT_TRUE(eventually([&] { return subscriber.lines().size() == 1; })) << gateway.log();
  const json state = json::parse(subscriber.lines()[0]);
  EXPECT_EQ(state["state"], "online");
  EXPECT_TRUE(state.contains("version") && state.contains("since")) << state;

  gateway.process().send_signal(SIGTERM);
  EXPECT_EQ(gateway.process().wait(), 0);
  Subscriber late(broker, "ntnu-slam/gateway/test/state", "%r %p");
  ASSERT_TRUE(eventually([&] { return late.lines().size() == 1; }));
  EXPECT_EQ(late.lines()[0], R"(1 {"state":"offline"})");
}

TEST(Daemon, EndsWithStatus0WhenSignalsComeUntilItHasEnded) {
  Mosquitto broker;
  GatewayProcess gateway(json{{"broker", {{"uri", broker.uri()}}}});
  for (const int signal : {SIGTERM, SIGINT, SIGHUP}) {
    ASSERT_TRUE(eventually([&] { return gateway.ctl({"status"}).is_object(); })) << gateway.log();
    gateway.process().send_signal(SIGTERM);
    EXPECT_TRUE(eventually([&] {
      for (int i = 0; i < 1000 && gateway.process().is_running(); ++i)
        gateway.process().send_signal(signal);
      return !gateway.process().is_running();
    }));
    EXPECT_EQ(gateway.process().wait(), 0) << signal;
    gateway.start();
  }
}

TEST(Daemon, LeavesItsLastWillWhenKilled) {
  Mosquitto broker;
  Subscriber subscriber(broker, "ntnu-slam/gateway/test/state", "%p");
  GatewayProcess gateway(json{{"broker", {{"uri", broker.uri()}}}});
  ASSERT_TRUE(eventually([&] { return subscriber.lines().size() == 1; })) << gateway.log();
  gateway.process().send_signal(SIGKILL);
  ASSERT_TRUE(eventually([&] { return subscriber.lines().size() == 2; }));
  EXPECT_EQ(subscriber.lines()[1], R"({"state":"offline"})");
}

TEST(Daemon, ReportsStatusRobotsAndOutcomeToOperator) {
  Mosquitto broker;
  GatewayProcess gateway(json{{"broker", {{"uri", broker.uri()}}}});
  SimulatorProcess simulator({"thread", "--gateway", gateway.mqttsn_address(), "--robots", "2"});
  ASSERT_TRUE(eventually([&] {
    const json status = gateway.ctl({"status"});
    return status.is_object() && status["broker"]["state"] == "up" &&
           status["robots"]["online"] == 2 && status["messages"]["published"] > 4;
  })) << gateway.ctl({"status"})
      << gateway.log();
  std::set<std::string> counters;
  const json messages = gateway.ctl({"status"})["messages"];
  for (const auto& [name, count] : messages.items()) counters.insert(name);
  EXPECT_EQ(counters, (std::set<std::string>{"down", "dropped", "inbound_dropped", "lost",
                                             "not_retained", "published", "refused", "rejected",
                                             "set_aside", "stored", "up"}));
  const json robots = gateway.ctl({"robots"});
  ASSERT_EQ(robots.size(), 2u) << robots;
  EXPECT_EQ(robots[0]["id"], "robot1");
  EXPECT_EQ(robots[0]["mesh"], "thread");
  EXPECT_EQ(robots[0]["state"], "online");

  const json outcome = gateway.ctl({"send", "robot1", "cmd", "10,-20"});
  EXPECT_EQ(outcome["outcome"], "delivered") << outcome;
  const Finished refused = run_program({SLAMGW_CTL, "--socket", gateway / "control.sock", "--json",
                                        "send", "robot1/x", "cmd", "10,-20"});
  EXPECT_EQ(refused.status, 1);
  EXPECT_NE(refused.out.find("robot and type must be one topic level each"), std::string::npos)
      << refused.out;
}

}  // namespace
}  // namespace slamgw::test
