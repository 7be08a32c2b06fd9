// SPDX-License-Identifier: Apache-2.0
// The daemon is killed right after an answer and restarted: it still has the session of each robot
// that was answered (docs/topics.md, promise 7). The parameter is the time after the answer.
#include <gtest/gtest.h>
#include <signal.h>

#include <thread>

#include "tests/e2e/device.hpp"
#include "tests/e2e/gateway_process.hpp"
#include "tests/support/mosquitto.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;
using sim::sn::Type;

class CrashAfterAnAnswer : public testing::TestWithParam<std::chrono::milliseconds> {
 protected:
  CrashAfterAnAnswer() {
    EXPECT_TRUE(eventually([&] { return gateway.logs(" connected (MQTT"); })) << gateway.log();
    device.connect_with_will("r1");
    ask(sim::sn::register_topic(7, "ntnu-slam/robot/r1/first"), Type::regack);
  }
  sim::sn::Packet ask(const sim::Bytes& request, Type answer) {
    device.send(request);
    const auto packet = device.expect(answer);
    EXPECT_EQ(packet.return_code, sim::sn::accepted);
    return packet;
  }
  void crash() {
    std::this_thread::sleep_for(GetParam());
    gateway.process().send_signal(SIGKILL);
    ASSERT_TRUE(eventually([&] { return !gateway.process().is_running(); }));
    gateway.start();
  }

  Mosquitto broker;
  GatewayProcess gateway{json{{"broker", {{"uri", broker.uri()}}}}};
  Device device{gateway.mqttsn_address()};
};

TEST_P(CrashAfterAnAnswer, KeepsRobotConnected) {
  Device late(gateway.mqttsn_address());
  late.send(sim::sn::connect("r2", 60, sim::sn::flag_clean_session));
  late.expect(Type::connack);
  crash();
  late.insist(sim::sn::pingreq(""), Type::pingresp);
}

TEST_P(CrashAfterAnAnswer, KeepsTopicRegistered) {
  const auto topic = ask(sim::sn::register_topic(1, "ntnu-slam/robot/r1/adv"), Type::regack);
  crash();
  const auto answer = device.insist(sim::sn::publish(1, topic.topic_id, 2, {}), Type::puback);
  EXPECT_EQ(answer.return_code, sim::sn::accepted);
}

TEST_P(CrashAfterAnAnswer, KeepsSubscription) {
  device.subscribe("ntnu-slam/server/r1/cmd");
  crash();
  device.insist(sim::sn::pingreq(""), Type::pingresp);
  mosquitto_publish(broker, {"-q", "1", "-t", "ntnu-slam/server/r1/cmd", "-m", "go"});
  EXPECT_EQ(device.expect(Type::publish).payload.size(), 2U);
}

TEST_P(CrashAfterAnAnswer, KeepsSleepingRobotAsleep) {
  device.subscribe("ntnu-slam/server/r1/cmd");
  device.send(sim::sn::disconnect(60));
  device.expect(Type::disconnect);
  crash();
  ASSERT_TRUE(eventually([&] { return gateway.logs("restored 1 MQTT-SN sessions"); }));
  mosquitto_publish(broker, {"-q", "1", "-t", "ntnu-slam/server/r1/cmd", "-m", "go"});
  ASSERT_TRUE(eventually([&] {
    const json robots = gateway.ctl({"robots"});
    return robots.is_array() && !robots.empty() && robots[0]["queue"] == 1;
  })) << gateway.ctl({"robots"});
  EXPECT_TRUE(device.is_silent()) << "it sleeps";
  device.send(sim::sn::pingreq("r1"));
  EXPECT_EQ(device.expect(Type::publish).payload.size(), 2U);
}

INSTANTIATE_TEST_SUITE_P(Within, CrashAfterAnAnswer,
                         testing::Values(std::chrono::milliseconds(0),
                                         std::chrono::milliseconds(20),
                                         std::chrono::milliseconds(50)),
                         [](const auto& wait) {
                           return std::to_string(wait.param.count()) + "ms";
                         });

}  // namespace
}  // namespace slamgw::test
