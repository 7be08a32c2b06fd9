// SPDX-License-Identifier: Apache-2.0
// Restarts, crashes and a reload that MQTT-SN devices do not notice (docs/topics.md, promise
// 7). The device uses the simulator's codec, which shares no code with the daemon's.
#include <gtest/gtest.h>
#include <signal.h>

#include <chrono>
#include <filesystem>
#include <map>
#include <tuple>

#include "tests/e2e/device.hpp"
#include "tests/e2e/gateway_process.hpp"
#include "tests/support/broker_of_version.hpp"
#include "tests/support/eventually.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;
using sim::sn::Type;

/// The signal that ends the daemon, and the MQTT version of the broker.
class Restart : public testing::TestWithParam<std::tuple<int, MqttVersion>> {
 protected:
  void connect() {
    // Before this, a SUBACK does not prove that the broker has the subscription.
    ASSERT_TRUE(eventually([&] { return gateway.logs(" connected (MQTT"); })) << gateway.log();
    device.insist(sim::sn::connect("r1", 60, sim::sn::flag_will | sim::sn::flag_clean_session),
                  Type::willtopicreq);
    device.send(sim::sn::willtopic("ntnu-slam/robot/r1/gone", 0));
    device.expect(Type::willmsgreq);
    device.send(sim::sn::willmsg("bye"));
    EXPECT_EQ(device.expect(Type::connack).return_code, 0);
    device.send(sim::sn::register_topic(1, "ntnu-slam/robot/r1/adv"));
    topic_id = device.expect(Type::regack).topic_id;
    device.send(sim::sn::subscribe(1, 2, "ntnu-slam/server/r1/cmd"));
    EXPECT_EQ(device.expect(Type::suback).return_code, 0);
  }
  bool is_on_disk(const std::string& text) {
    return eventually(
        [&] { return read_files(gateway / "store/sessions").find(text) != std::string::npos; });
  }
  /// Ends the daemon by the signal of the parameter and starts another one.
  void restart() {
    gateway.process().send_signal(std::get<int>(GetParam()));
    ASSERT_TRUE(eventually([&] { return !gateway.process().is_running(); }));
    gateway.start();
  }

  BrokerOfVersion broker{std::get<MqttVersion>(GetParam())};
  GatewayProcess gateway{json{{"broker", {{"uri", broker.link_uri()}}}}};
  Device device{gateway.mqttsn_address()};
  std::uint16_t topic_id = 0;
};

TEST_P(Restart, IsNotNoticedByADevice) {
  Subscriber subscriber(broker, "ntnu-slam/robot/r1/#");
  connect();
  ASSERT_TRUE(is_on_disk("server/r1/cmd")) << gateway.log();
  restart();
  const std::vector<std::uint8_t> payload{'a', 'f', 't', 'e', 'r'};
  const auto answer = device.insist(sim::sn::publish(1, topic_id, 3, payload), Type::puback);
  EXPECT_EQ(answer.return_code, 0);
  EXPECT_EQ(answer.topic_id, topic_id);
  EXPECT_TRUE(eventually([&] { return !subscriber.lines().empty(); }));
  EXPECT_EQ(subscriber.lines(), std::vector<std::string>{"ntnu-slam/robot/r1/adv 6166746572"})
      << "no will: the robot was never lost";
  mosquitto_publish(broker, {"-q", "1", "-t", "ntnu-slam/server/r1/cmd", "-m", "go"});
  EXPECT_EQ(device.expect(Type::publish).payload.size(), 2U);
  EXPECT_TRUE(device.is_silent());
  EXPECT_TRUE(gateway.logs("restored 1 MQTT-SN sessions")) << gateway.log();
}

TEST_P(Restart, KeepsOutcomeOfCommand) {
  Subscriber outcomes(broker, "ntnu-slam/gateway/test/commands/#", "%p");
  connect();
  mosquitto_publish(broker, {"-q", "1", "-t", "ntnu-slam/server/r1/cmd", "-m", "slowly"});
  device.expect(Type::publish);
  ASSERT_TRUE(is_on_disk("slowly")) << gateway.log();
  restart();
  const auto again = device.expect(Type::publish);
  EXPECT_TRUE(outcomes.lines().empty());
  device.send(sim::sn::puback(again.topic_id, again.msg_id, 0));
  ASSERT_TRUE(eventually([&] { return !outcomes.lines().empty(); })) << gateway.log();
  EXPECT_EQ(json::parse(outcomes.lines()[0])["outcome"], "delivered");
}

INSTANTIATE_TEST_SUITE_P(After, Restart,
                         testing::Combine(testing::Values(SIGTERM, SIGKILL), either_version),
                         [](const auto& how) {
                           const bool is_orderly = std::get<int>(how.param) == SIGTERM;
                           return std::string(is_orderly ? "Sigterm" : "Sigkill") +
                                  name_of(std::get<MqttVersion>(how.param));
                         });

using CommandsOverBle = OverEitherVersion;
INSTANTIATE_TEST_SUITE_P(Over, CommandsOverBle, either_version, CommandsOverBle::name);

TEST_P(CommandsOverBle, HaveOutcomeAfterKill) {
  Subscriber outcomes(broker, "ntnu-slam/gateway/test/commands/#", "%t %p");
  GatewayProcess gateway(json{{"broker", {{"uri", broker.link_uri()}}},
                              {"ble_mesh", {{"enabled", true}}},
                              {"robots", json::array({{{"id", "r1"}, {"ble_address", 0x0100}}})}});
  SimulatorProcess deaf_robot(
      {"ble", "--tty", gateway.tty(), "--robots", "1", "--loss", "1", "--rate", "0.1"});
  ASSERT_TRUE(eventually([&] { return gateway.logs("ble link up"); })) << gateway.log();
  ASSERT_TRUE(eventually([&] { return gateway.logs(" connected (MQTT"); })) << gateway.log();
  for (const char* type : {"first", "second"})
    mosquitto_publish(broker,
                      {"-q", "1", "-t", std::string("ntnu-slam/server/r1/") + type, "-m", "go"});
  const auto is_kept = [&] {
    std::string kept;
    for (const auto& file : std::filesystem::directory_iterator(gateway / "store/ble-commands"))
      kept += read_file(file.path());
    return kept.find("first") != std::string::npos && kept.find("second") != std::string::npos;
  };
  ASSERT_TRUE(eventually(is_kept)) << gateway.log();
  gateway.process().send_signal(SIGKILL);
  ASSERT_TRUE(eventually([&] { return !gateway.process().is_running(); }));
  EXPECT_TRUE(outcomes.lines().empty());
  gateway.start();
  ASSERT_TRUE(eventually([&] { return outcomes.lines().size() == 2; })) << gateway.log();
  const std::string topic = "ntnu-slam/gateway/test/commands/r1 ";
  std::map<std::string, std::string> ended;
  for (const std::string& line : outcomes.lines()) {
    ASSERT_EQ(line.substr(0, topic.size()), topic);
    const json outcome = json::parse(line.substr(topic.size()));
    ended[outcome["type"]] = outcome["outcome"];
  }
  EXPECT_EQ(ended,
            (std::map<std::string, std::string>{{"first", "timeout"}, {"second", "refused"}}))
      << gateway.log();
}

TEST(LastOnline, IsNotUpdatedWithoutBroker) {
  namespace fs = std::filesystem;
  Mosquitto broker;
  GatewayProcess gateway(json{{"broker", {{"uri", broker.uri()}}}});
  const std::string file = gateway / "store/alive";
  ASSERT_TRUE(eventually([&] { return fs::exists(file); })) << gateway.log();
  broker.kill();
  ASSERT_TRUE(eventually([&] { return gateway.logs("cannot reach broker"); })) << gateway.log();
  const auto then = fs::file_time_type::clock::now() - std::chrono::hours{1};
  fs::last_write_time(file, then);
  gateway.process().send_signal(SIGTERM);
  ASSERT_TRUE(eventually([&] { return !gateway.process().is_running(); }));
  EXPECT_EQ(fs::last_write_time(file), then);
}

TEST(Reload, ChangesBrokerWithoutDroppingSessions) {
  Mosquitto first;
  Mosquitto second;
  GatewayProcess gateway(json{{"broker", {{"uri", first.uri()}}}});
  Device device(gateway.mqttsn_address());
  device.insist(sim::sn::connect("r1", 60, sim::sn::flag_clean_session), Type::connack);
  device.send(sim::sn::register_topic(1, "ntnu-slam/robot/r1/adv"));
  const std::uint16_t topic_id = device.expect(Type::regack).topic_id;

  gateway.reload([&](json& configuration) {
    configuration["broker"]["uri"] = second.uri();
    configuration["mqttsn"]["gateway_id"] = 9;
  });

  Subscriber subscriber(second, "ntnu-slam/robot/r1/adv");
  ASSERT_TRUE(eventually([&] { return gateway.logs("only a restart changes: mqttsn.*"); }))
      << gateway.log();
  EXPECT_EQ(device.insist(sim::sn::publish(1, topic_id, 2, {}), Type::puback).return_code, 0);
  EXPECT_TRUE(eventually([&] { return subscriber.lines().size() == 1; })) << gateway.log();
}

}  // namespace
}  // namespace slamgw::test
