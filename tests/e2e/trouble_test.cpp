// SPDX-License-Identifier: Apache-2.0
// Bad input and absent peers: each has a clear log line and a defined behaviour; the daemon goes
// on.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <unistd.h>

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/ip/udp.hpp>
#include <filesystem>
#include <optional>
#include <thread>

#include "tests/e2e/gateway_process.hpp"
#include "tests/support/broker_of_version.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/free_port.hpp"
#include "tests/support/mosquitto.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;

/// Returns how often the threads have gone to sleep (proc(5)); nothing while one of them runs.
std::optional<long> sleeps(pid_t pid) {
  long all = 0;
  for (const auto& thread :
       std::filesystem::directory_iterator("/proc/" + std::to_string(pid) + "/task")) {
    const std::string status = read_file(thread.path() / "status");
    if (status.find("State:\tS") == std::string::npos) return std::nullopt;
    const std::string field = "\nvoluntary_ctxt_switches:";
    all += std::stol(status.substr(status.find(field) + field.size()));
  }
  return all;
}

using BrokerThatIsDown = OverEitherVersion;
INSTANTIATE_TEST_SUITE_P(Over, BrokerThatIsDown, either_version, BrokerThatIsDown::name);

TEST_P(BrokerThatIsDown, DaemonWaitsForItAtStart) {
  broker.kill();
  GatewayProcess gateway(json{{"broker", {{"uri", broker.link_uri()}}}});
  ASSERT_TRUE(eventually([&] { return gateway.logs("cannot reach broker"); })) << gateway.log();
  SimulatorProcess simulator({"thread", "--gateway", gateway.mqttsn_address(), "--robots", "2",
                              "--messages", "5", "--rate", "20"});

  broker.start();  // no SEARCHGW was answered before

  Subscriber subscriber(broker, "ntnu-slam/robot/#");
  const json report = simulator.report();
  EXPECT_EQ(report["lost"], 0) << report;
  EXPECT_EQ(report["acknowledged"], report["sent"]) << report;
  EXPECT_TRUE(gateway.logs(GetParam() == MqttVersion::v5 ? "connected (MQTT 5)"
                                                         : "connected (MQTT 3.1.1)"));
}

TEST(Trouble, SilentBrokerIsDownSinceStart) {
  using boost::asio::ip::tcp;
  boost::asio::io_context io;
  const tcp::acceptor silent(io, {boost::asio::ip::address_v4::loopback(), 0});
  const std::string uri = "mqtt://127.0.0.1:" + std::to_string(silent.local_endpoint().port());
  GatewayProcess gateway(json{{"broker", {{"uri", uri}}}});
  json status;
  ASSERT_TRUE(eventually([&] { return (status = gateway.ctl({"status"})).is_object(); }));
  const json& broker = status["broker"];
  EXPECT_EQ(broker["state"], "down");
  EXPECT_EQ(broker["why"], "no broker has answered since the start");
  EXPECT_NE(broker["since"].get<std::string>().substr(0, 4), "1970");
}

TEST(Trouble, WrongPasswordNamesFileAndIsNotShown) {
  Mosquitto broker({}, "gw", "right");
  const TempDir directory;
  write_file(directory / "credentials.json", R"({"username":"gw","password":"wr0ng-secret"})",
             0600);
  GatewayProcess gateway(json{
      {"broker", {{"uri", broker.uri()}, {"credentials_file", directory / "credentials.json"}}}});
  ASSERT_TRUE(eventually([&] { return gateway.logs("does not authorise"); })) << gateway.log();
  EXPECT_TRUE(gateway.logs("credentials.json")) << "names the file to correct";
  EXPECT_FALSE(gateway.logs("wr0ng-secret"));
  EXPECT_TRUE(gateway.process().is_running());
}

TEST(Trouble, MissingTtyIsShownAsDownUntilBoardAppears) {
  Mosquitto broker;
  GatewayProcess gateway(
      json{{"broker", {{"uri", broker.uri()}}}, {"ble_mesh", {{"enabled", true}}}});
  ASSERT_TRUE(eventually([&] { return gateway.logs(gateway.tty()); })) << gateway.log();
  ASSERT_TRUE(eventually([&] {
    const json status = gateway.ctl({"status"});
    return status.is_object() && status["meshes"]["ble"]["state"] == "down" &&
           status["meshes"]["thread"]["state"] == "up";
  })) << gateway.log();

  SimulatorProcess board({"ble", "--tty", gateway.tty(), "--robots", "1"});
  ASSERT_TRUE(eventually([&] { return gateway.logs("ble-0100 update"); })) << gateway.log();
}

TEST(Trouble, ReopensReplacedBoard) {
  Mosquitto broker;
  GatewayProcess gateway(
      json{{"broker", {{"uri", broker.uri()}}}, {"ble_mesh", {{"enabled", true}}}});
  const std::vector<std::string> arguments{"ble", "--tty", gateway.tty(), "--robots", "1"};
  {
    SimulatorProcess board(arguments);
    ASSERT_TRUE(eventually([&] { return gateway.logs("ble-0100 update"); })) << gateway.log();
    board.process().send_signal(SIGKILL);
  }
  ASSERT_TRUE(eventually([&] { return gateway.logs("ble link down"); })) << gateway.log();
  unlink(gateway.tty().c_str());
  Subscriber subscriber(broker, "ntnu-slam/robot/ble-0100/update");
  SimulatorProcess board(arguments);
  EXPECT_TRUE(eventually([&] { return !subscriber.lines().empty(); })) << gateway.log();
}

TEST(Trouble, InvalidDatagramsAreCountedAndHarmNoRobot) {
  Mosquitto broker;
  GatewayProcess gateway(json{{"broker", {{"uri", broker.uri()}}}});
  ASSERT_TRUE(eventually([&] { return gateway.logs("connected (MQTT 5)"); })) << gateway.log();
  using boost::asio::ip::udp;
  boost::asio::io_context io;
  udp::socket socket(io, udp::endpoint(udp::v4(), 0));
  const std::string address = gateway.mqttsn_address();
  const udp::endpoint target(
      boost::asio::ip::address_v4::loopback(),
      static_cast<std::uint16_t>(std::stoi(address.substr(address.find(':') + 1))));
  constexpr int sent = 200;
  for (int i = 0; i < sent; ++i) {
    const std::string junk(static_cast<std::size_t>(i * 7 % 1400), static_cast<char>(i));
    socket.send_to(boost::asio::buffer(junk), target);
  }
  SimulatorProcess simulator({"thread", "--gateway", address, "--robots", "1", "--messages", "3"});
  EXPECT_EQ(simulator.report()["lost"], 0) << gateway.log();
  const json counters = gateway.ctl({"status"})["meshes"]["thread"]["counters"];
  EXPECT_GT(counters["malformed"], sent / 2) << counters;
}

/// A busy loop runs, or wakes up, most of the time. The daemon rests between its attempts.
TEST(Trouble, RestsWithoutBrokerAndBoard) {
  GatewayProcess gateway(
      json{{"broker", {{"uri", "mqtt://127.0.0.1:" + std::to_string(free_tcp_port())}}},
           {"ble_mesh", {{"enabled", true}}}});
  ASSERT_TRUE(eventually([&] { return gateway.logs("cannot reach broker"); })) << gateway.log();
  int rests = 0;
  for (int i = 0; i < 50; ++i) {
    const auto before = sleeps(gateway.process().pid());
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    if (before && sleeps(gateway.process().pid()) == before) ++rests;
  }
  EXPECT_GE(rests, 25);
}

}  // namespace
}  // namespace slamgw::test
