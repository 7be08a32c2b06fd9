// SPDX-License-Identifier: Apache-2.0
// What operators and servers learn about their commands, with a robot that answers as the test
// says.
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

class CommandFates : public OverEitherVersion {
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

INSTANTIATE_TEST_SUITE_P(Over, CommandFates, either_version, CommandFates::name);

TEST_P(CommandFates, OfAnOperatorBesideThoseOfTheServerHaveTheirOwnOutcome) {
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

}  // namespace
}  // namespace slamgw::test
