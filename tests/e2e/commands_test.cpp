// SPDX-License-Identifier: Apache-2.0
// Outcomes of commands for operators and servers, with a robot that the test controls.
#include <gtest/gtest.h>

#include <algorithm>

#include "tests/e2e/device.hpp"
#include "tests/e2e/gateway_process.hpp"
#include "tests/support/broker_of_version.hpp"
#include "tests/support/eventually.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;
using sim::sn::Type;

class CommandOutcomes : public OverEitherVersion {
 protected:
  static constexpr std::uint8_t accepted = 0;
  static constexpr std::uint8_t not_supported = 3;

  void SetUp() override {
    ASSERT_TRUE(eventually([&] { return gateway.logs(" connected (MQTT"); })) << gateway.log();
    device.insist(sim::sn::connect("r1", 60, sim::sn::flag_clean_session), Type::connack);
    device.send(sim::sn::subscribe(1, 2, "ntnu-slam/server/r1/cmd"));
    EXPECT_EQ(device.expect(Type::suback).return_code, accepted);
  }
  bool is_queue(std::size_t depth) {
    return eventually([&] {
      const json robots = gateway.ctl({"robots"});
      return robots.is_array() && robots.size() == 1 && robots[0]["queue"] == depth;
    });
  }
  void answer(std::uint8_t code) {
    const auto command = device.expect(Type::publish);
    device.send(sim::sn::puback(command.topic_id, command.msg_id, code));
  }

  GatewayProcess gateway{json{{"broker", {{"uri", broker.link_uri()}}}}};
  Device device{gateway.mqttsn_address()};
};

INSTANTIATE_TEST_SUITE_P(Over, CommandOutcomes, either_version, CommandOutcomes::name);

TEST_P(CommandOutcomes, ReachOperatorBesideCommandsOfServer) {
  for (const char* text : {"one", "two"})
    mosquitto_publish(broker, {"-q", "1", "-t", "ntnu-slam/server/r1/cmd", "-m", text});
  ASSERT_TRUE(is_queue(2)) << gateway.log();
  ChildProcess ctl(
      {SLAMGW_CTL, "--socket", gateway / "control.sock", "--json", "send", "r1", "cmd", "10,-20"},
      gateway / "outcome", gateway / "problem");
  ASSERT_TRUE(is_queue(3)) << gateway.log();
  answer(not_supported);
  answer(not_supported);
  answer(accepted);
  EXPECT_EQ(ctl.wait(), 0);
  EXPECT_EQ(json::parse(read_file(gateway / "outcome"))["outcome"], "delivered");
}

/// `r1` is the only robot of a gateway that is alone on the broker.
TEST_P(CommandOutcomes, AreRefusedForUnknownRobotsAndPublishedOncePerCommand) {
  Subscriber outcomes(broker, "ntnu-slam/gateway/test/commands/#", "%t %p");
  const auto say = [&](const std::string& topic, const std::string& text) {
    mosquitto_publish(broker, {"-q", "1", "-t", "ntnu-slam/server/" + topic, "-m", text});
  };
  say("ghost/cmd", "go");
  say("another-gateway/probe", "1-1");
  for (int i = 0; i < 2; ++i) say("r1/cmd", "the same");
  for (int i = 0; i < 2; ++i) answer(accepted);
  ASSERT_TRUE(eventually([&] { return outcomes.lines().size() >= 3; })) << gateway.log();
  say("ghost/run", "last");
  ASSERT_TRUE(eventually([&] { return outcomes.lines().size() >= 4; })) << gateway.log();
  std::vector<std::string> ended;
  for (const std::string& line : outcomes.lines()) {
    const json outcome = json::parse(line.substr(line.find('{')));
    ended.push_back(
        line.substr(line.find("/commands/") + 10, line.find(' ') - line.find("/commands/") - 10) +
        " " + outcome["type"].get<std::string>() + " " + outcome["outcome"].get<std::string>());
  }
  std::sort(ended.begin(), ended.end());
  EXPECT_EQ(ended, (std::vector<std::string>{"ghost cmd refused", "ghost run refused",
                                             "r1 cmd delivered", "r1 cmd delivered"}));
  EXPECT_TRUE(device.is_silent()) << "a duplicate from the broker is not delivered";
}

TEST_P(CommandOutcomes, AreLoggedWithSender) {
  mosquitto_publish(broker, {"-V", "5", "-D", "publish", "user-property", "sender", "planner", "-q",
                             "1", "-t", "ntnu-slam/server/r1/cmd", "-m", "go"});
  answer(accepted);
  const std::string outcome = "thread r1 cmd delivered after ";
  ASSERT_TRUE(eventually([&] { return gateway.logs(outcome); })) << gateway.log();
  EXPECT_EQ(gateway.logs("; asked by broker: planner"), GetParam() == MqttVersion::v5)
      << gateway.log();
  gateway.ctl({"forget", "r7"});
  EXPECT_TRUE(gateway.logs("forget r7: done; asked by uid ")) << gateway.log();
  gateway.reload([](json& configuration) { configuration["log"] = {{"level", "error"}}; });
  ASSERT_TRUE(eventually([&] { return gateway.logs("reload: done; asked by SIGHUP"); }))
      << gateway.log();
  gateway.ctl({"forget", "r8"});
  EXPECT_TRUE(gateway.logs("forget r8: done")) << "orders of operators are logged at any level";
}

/// RabbitMQ and HiveMQ send no duplicates either.
TEST(CommandsOfABrokerWithoutCopies, AreAllDelivered) {
  BrokerOfVersion broker(MqttVersion::v3_1_1, "allow_duplicate_messages false");
  GatewayProcess gateway(json{{"broker", {{"uri", broker.link_uri()}}}});
  Device device(gateway.mqttsn_address());
  ASSERT_TRUE(eventually([&] { return gateway.logs(" connected (MQTT"); })) << gateway.log();
  device.insist(sim::sn::connect("r1", 60, sim::sn::flag_clean_session), Type::connack);
  device.send(sim::sn::subscribe(1, 2, "ntnu-slam/server/r1/cmd"));
  device.expect(Type::suback);
  for (int i = 0; i < 4; ++i) {
    mosquitto_publish(broker,
                      {"-q", "1", "-t", "ntnu-slam/server/r1/cmd", "-m", "the same each time"});
    const auto command = device.expect(Type::publish);
    device.send(sim::sn::puback(command.topic_id, command.msg_id, sim::sn::accepted));
  }
}

}  // namespace
}  // namespace slamgw::test
