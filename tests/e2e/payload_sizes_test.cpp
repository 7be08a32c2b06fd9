// SPDX-License-Identifier: Apache-2.0
// Payloads at the bounds that docs/topics.md names ("How long a payload may be") pass whole, from a
// robot to the broker and from the broker to a robot, or are refused.
#include <gtest/gtest.h>

#include <signal.h>

#include <algorithm>

#include "daemon/core/bytes.hpp"
#include "tests/e2e/device.hpp"
#include "tests/e2e/gateway_process.hpp"
#include "tests/support/broker_of_version.hpp"
#include "tests/support/eventually.hpp"

namespace slamgw::test {
namespace {

using nlohmann::json;
using sim::sn::Type;

/// Each octet differs from its neighbours.
std::string octets(std::size_t size) {
  std::string text(size, '\0');
  for (std::size_t i = 0; i < size; ++i) text[i] = static_cast<char>(i * 7 + i / 256);
  return text;
}

std::string in_hex(std::string_view text) {
  constexpr std::string_view digits = "0123456789abcdef";
  std::string hex;
  for (const char c : text) {
    const auto octet = static_cast<unsigned char>(c);
    hex += {digits[octet >> 4], digits[octet & 15]};
  }
  return hex;
}

class PayloadSizesEndToEnd : public OverEitherVersion {
 protected:
  void command(const std::string& to, const std::string& payload) {
    write_file(gateway / "payload", payload);
    mosquitto_publish(
        broker, {"-q", "1", "-t", "ntnu-slam/server/" + to + "/blob", "-f", gateway / "payload"});
  }
  /// Returns how many of the outcomes so far equal `outcome`.
  std::ptrdiff_t count(const std::string& outcome) {
    return std::ranges::count_if(outcomes.lines(), [&](const std::string& line) {
      return json::parse(line)["outcome"] == outcome;
    });
  }

  GatewayProcess gateway{json{{"broker", {{"uri", broker.link_uri()}}},
                              {"ble_mesh", {{"enabled", true}}},
                              {"robots", {{{"id", "lego-1"}, {"ble_address", 0x0100}}}}}};
  Subscriber outcomes{broker, "ntnu-slam/gateway/test/commands/+", "%p"};
};

INSTANTIATE_TEST_SUITE_P(Over, PayloadSizesEndToEnd, either_version, PayloadSizesEndToEnd::name);

TEST_P(PayloadSizesEndToEnd, PassOnThreadUpToBounds) {
  ASSERT_TRUE(eventually([&] { return gateway.logs(" connected (MQTT"); })) << gateway.log();
  const Subscriber robot(broker, "ntnu-slam/robot/r1/blob", "%x");
  Device device(gateway.mqttsn_address());
  device.connect_with_will("r1");
  device.subscribe("ntnu-slam/server/r1/blob");
  device.send(sim::sn::register_topic(3, "ntnu-slam/robot/r1/blob"));
  const std::uint16_t topic = device.expect(Type::regack).topic_id;

  std::vector<std::string> said;
  std::uint16_t msg_id = 10;
  for (const std::size_t size : {0U, 247U, 248U, 249U, 250U, 1222U, 1223U}) {
    const std::string payload = octets(size);
    said.push_back(in_hex(payload));
    device.send(sim::sn::publish(1, topic, ++msg_id, to_bytes(payload)));
    EXPECT_EQ(device.expect(Type::puback).return_code, sim::sn::accepted) << size;
  }
  device.send(sim::sn::publish(1, topic, ++msg_id, to_bytes(octets(1224))));  // not answered
  EXPECT_TRUE(eventually([&] { return robot.lines() == said; })) << robot.lines().size();

  for (const std::size_t size : {248U, 249U, 1223U}) {
    command("r1", octets(size));
    const auto message = device.expect(Type::publish);
    EXPECT_EQ(in_hex(as_text(message.payload)), in_hex(octets(size)));
    device.send(sim::sn::puback(message.topic_id, message.msg_id, sim::sn::accepted));
  }
  command("r1", octets(1224));
  EXPECT_TRUE(eventually([&] { return count("delivered") == 3 && count("refused") == 1; }))
      << gateway.log();
}

TEST_P(PayloadSizesEndToEnd, PassOnBleUpToBounds) {
  SimulatorProcess simulator({"ble", "--tty", gateway.tty(), "--robots", "1", "--acknowledged",
                              "--rate", "0.5", "--record", gateway / "record"});
  ASSERT_TRUE(eventually([&] { return gateway.logs("lego-1 update"); })) << gateway.log();
  std::ptrdiff_t sent = 0;
  for (const std::size_t size : {1U, 8U, 9U, 17U, 18U, 240U, 241U}) {
    command("lego-1", octets(size));
    ++sent;
    EXPECT_TRUE(eventually([&] { return count("delivered") == sent; })) << size << gateway.log();
    EXPECT_NE(read_file(gateway / "record").find(" min_com " + in_hex(octets(size)) + " "),
              std::string::npos)
        << size;
  }
  command("lego-1", octets(242));
  EXPECT_TRUE(eventually([&] { return count("refused") == 1; })) << gateway.log();
  EXPECT_EQ(count("delivered"), sent);
}

}  // namespace
}  // namespace slamgw::test
