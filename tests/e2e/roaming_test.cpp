// SPDX-License-Identifier: Apache-2.0
// Two gateways on one broker, and robots that go from one to the other without a word.
#include <gtest/gtest.h>

#include <algorithm>

#include "tests/e2e/device.hpp"
#include "tests/e2e/gateway_process.hpp"
#include "tests/support/eventually.hpp"
#include "tests/support/mosquitto.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;
using sim::sn::Type;

class TwoGateways : public testing::Test {
 protected:
  static constexpr std::uint8_t keep_alive_s = 60;

  static json configuration(const Mosquitto& broker, const std::string& id) {
    return {{"gateway", {{"id", id}}}, {"broker", {{"uri", broker.uri()}}}};
  }
  void SetUp() override {
    for (GatewayProcess* gateway : {&a, &b})
      ASSERT_TRUE(eventually([&] { return state_of(*gateway) == "member"; })) << gateway->log();
  }
  /// What a gateway says of itself.
  static std::string state_of(const GatewayProcess& gateway) {
    const json fleet = gateway.ctl({"fleet"});
    return fleet.is_object() ? fleet["gateways"][0].value("state", "") : "";
  }
  /// Where a gateway believes a robot to be.
  static std::string place_of(const GatewayProcess& gateway, const std::string& robot) {
    const json fleet = gateway.ctl({"fleet"});
    if (!fleet.is_object()) return "";
    for (const json& row : fleet["robots"])
      if (row["robot"] == robot) return row["gateway"];
    return "";
  }
  static void connect_with_will(Device& device, const std::string& robot) {
    device.insist(sim::sn::connect(robot, keep_alive_s, sim::sn::flag_will), Type::willtopicreq);
    device.send(sim::sn::willtopic("ntnu-slam/robot/" + robot + "/gone", 0x20));
    device.expect(Type::willmsgreq);
    device.send(sim::sn::willmsg("will"));
    EXPECT_EQ(device.expect(Type::connack).return_code, sim::sn::accepted);
  }
  static void subscribe(Device& device, const std::string& robot) {
    device.send(sim::sn::subscribe(1, 2, "ntnu-slam/server/" + robot + "/cmd"));
    EXPECT_EQ(device.expect(Type::suback).return_code, sim::sn::accepted);
  }
  std::size_t count(const std::string& start) const {
    const auto lines = everything.lines();
    return static_cast<std::size_t>(
        std::ranges::count_if(lines, [&](const auto& line) { return line.starts_with(start); }));
  }

  Mosquitto broker;
  Subscriber everything{broker, "ntnu-slam/#", "%t %p"};
  GatewayProcess a{configuration(broker, "a")};
  GatewayProcess b{configuration(broker, "b")};
};

TEST_F(TwoGateways, RobotThatMovesHasOneGatewayOneOutcomeAndNoWill) {
  Device at_a{a.mqttsn_address()};
  connect_with_will(at_a, "r1");
  subscribe(at_a, "r1");
  ASSERT_TRUE(eventually([&] { return place_of(b, "r1") == "a"; })) << b.log();

  Device at_b{b.mqttsn_address()};
  connect_with_will(at_b, "r1");
  ASSERT_TRUE(eventually([&] { return place_of(a, "r1") == "b"; })) << a.log();
  // Without a session of the robot there is nothing that a could publish its will for.
  ASSERT_TRUE(eventually([&] { return a.ctl({"robots"}).empty(); })) << a.log();

  // The subscription came along; the gateway tells the topic's id anew.
  mosquitto_publish(broker, {"-q", "1", "-t", "ntnu-slam/server/r1/cmd", "-m", "1,2"});
  const auto topic = at_b.expect(Type::register_topic);
  at_b.send(sim::sn::regack(topic.topic_id, topic.msg_id, sim::sn::accepted));
  const auto message = at_b.expect(Type::publish);
  at_b.send(sim::sn::puback(message.topic_id, message.msg_id, sim::sn::accepted));
  ASSERT_TRUE(eventually([&] { return count("ntnu-slam/gateway/b/commands/r1") == 1; }));
  EXPECT_EQ(count("ntnu-slam/robot/r1/gone"), 0U);
  EXPECT_EQ(count("ntnu-slam/gateway/a/commands/r1"), 0U);

  const Subscriber presence{broker, "ntnu-slam/gateway/+/robots/r1", "%t %p"};
  ASSERT_TRUE(eventually([&] { return !presence.lines().empty(); }));
  ASSERT_EQ(presence.lines().size(), 1U);
  EXPECT_TRUE(
      presence.lines()[0].starts_with("ntnu-slam/gateway/b/robots/r1 {\"state\":\"online\""))
      << presence.lines()[0];
}

}  // namespace
}  // namespace slamgw::test
