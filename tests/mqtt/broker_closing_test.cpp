// SPDX-License-Identifier: Apache-2.0
// Real brokers that close the connection instead of refusing a message (Mosquitto, NATS), and one
// that stands still with the connection open.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <string>
#include <vector>

#include "tests/mqtt/delivery_rig.hpp"
#include "tests/support/mosquitto.hpp"
#include "tests/support/nats_server.hpp"

namespace slamgw {
namespace {

using namespace std::chrono_literals;

using BrokerClosing = WithEachClientAndVersion;
INSTANTIATE_TEST_SUITE_P(Over, BrokerClosing, testing::Combine(each_client, either_version),
                         BrokerClosing::name);

std::size_t distinct(std::vector<std::string> lines) {
  std::sort(lines.begin(), lines.end());
  return static_cast<std::size_t>(std::unique(lines.begin(), lines.end()) - lines.begin());
}

/// Publishes for a second robot until `condition` holds. Returns whether it holds.
bool talk_until(DeliveryRig& gateway, std::uint64_t& number,
                const std::function<bool()>& condition) {
  constexpr std::chrono::minutes limit{5};  // the pauses between trials grow
  return gateway.sees(
      [&] {
        if (gateway.depth() < 50) gateway.submit("r/2/update", ++number);
        return condition();
      },
      limit);
}

/// The gateway's adapters refuse U+0085; this test passes it on.
TEST_P(BrokerClosing, MakesADeadLetterOfAMessageForWhichMosquittoCloses) {
  BrokerOfVersion broker(version());
  const test::Subscriber subscriber(broker, "r/2/#", "%t %p");
  test::TempDir store;
  std::uint64_t number = 1;
  {
    DeliveryRig gateway(settings_for(broker.link_port()), store.path());
    ASSERT_TRUE(gateway.sees([&] { return gateway.is_up; }));
    gateway.submit("r/1/a\xc2\x85", 1);
    ASSERT_TRUE(talk_until(gateway, number, [&] {
      return gateway.logs("a message of 1 octets on");
    })) << testing::PrintToString(gateway.notices);
    EXPECT_TRUE(gateway.sees([&] { return gateway.depth() == 0; }));
    EXPECT_EQ(gateway.outbox.backlog().dead_letters().count, 1u);
    // libmosquitto refuses to send it.
    EXPECT_TRUE(gateway.ups == 1 ||
                gateway.logs("is a dead letter now: the connection was lost each time"));
    EXPECT_LE(gateway.ups, 12u)
        << "four losses, and one more whenever no other message was acknowledged";
    EXPECT_EQ(gateway.fired.at(1), ReceiptOutcome::safe);
  }
  DeliveryRig again(settings_for(broker.link_port()), store.path());
  ASSERT_TRUE(again.sees([&] { return again.is_up; }));
  ASSERT_TRUE(talk_until(again, number, [&] { return again.fired.size() >= 100; }));
  EXPECT_EQ(again.ups, 1u) << "a dead letter stays one";
  ASSERT_TRUE(again.sees([&] { return again.depth() == 0; }));
  EXPECT_TRUE(again.sees([&] { return distinct(subscriber.lines()) == number - 1; }))
      << distinct(subscriber.lines()) << " of " << number - 1;
}

/// MQTT 3.1.1 cannot announce the limit.
TEST(BrokerClosing311, MakesADeadLetterOfATooLargeMessageAndDeliversOthers) {
  test::Mosquitto broker("max_packet_size 500");
  test::Mqtt311Proxy proxy(broker.port());
  const test::Subscriber subscriber(broker, "r/#", "%t %l");
  DeliveryRig gateway(settings_for(proxy.port()));
  ASSERT_TRUE(gateway.sees([&] { return gateway.is_up; }));
  std::uint64_t number = 1;
  gateway.submit_bytes("r/1/map", Bytes(600, 'x'), 1);
  ASSERT_TRUE(talk_until(gateway, number,
                         [&] { return gateway.outbox.backlog().dead_letters().count == 1; }));
  EXPECT_TRUE(gateway.sees([&] { return gateway.depth() == 0; }));
  EXPECT_EQ(gateway.fired.at(1), ReceiptOutcome::safe);
  gateway.submit_bytes("r/1/map", Bytes(60, 'x'), ++number);
  EXPECT_TRUE(gateway.sees([&] { return gateway.depth() == 0; }))
      << "later messages of its topic are published";
  EXPECT_EQ(gateway.fired.size(), number);
}

/// NATS maps `/` to `.`, and closes the connection on a `.` or a space in a topic.
TEST(BrokerClosingNats, RobotWithADotInItsNameDoesNotDisconnectOthers) {
  if (!test::NatsServer::is_installed()) GTEST_SKIP() << "nats-server is not installed";
  test::NatsServer broker;
  DeliveryRig gateway(settings_for(broker.mqtt_port()));
  ASSERT_TRUE(gateway.sees([&] { return gateway.is_up; }));
  std::uint64_t number = 100;
  gateway.submit("robot/lo.ad0/update", 1);
  gateway.submit("robot/lo.ad0/ir", 2, Qos::at_most_once);
  ASSERT_TRUE(talk_until(gateway, number,
                         [&] {
                           gateway.submit("robot/lo.ad0/ir", 2, Qos::at_most_once);
                           return gateway.outbox.backlog().dead_letters().count == 1 &&
                                  gateway.logs("messages of QoS 0 on robot/lo.ad0/ir are dropped");
                         }))
      << testing::PrintToString(gateway.notices) << gateway.ups;
  const std::size_t ups = gateway.ups;
  const std::size_t published = gateway.outbox.statistics().published;
  ASSERT_TRUE(talk_until(gateway, number,
                         [&] { return gateway.outbox.statistics().published >= published + 200; }));
  EXPECT_LE(gateway.ups, ups + 1) << "the connection stays for other robots";
}

std::uint64_t unix_ms() {
  return static_cast<std::uint64_t>(std::chrono::duration_cast<std::chrono::milliseconds>(
                                        std::chrono::system_clock::now().time_since_epoch())
                                        .count());
}

/// The broker stands still for 25 s. Messages sent before the gateway noticed are in the broker's
/// socket and cannot be withdrawn.
TEST_P(BrokerClosing, DropsMessagesOfQos0DuringAStallInsteadOfSendingThemLate) {
  BrokerOfVersion broker(version());
  const test::Subscriber subscriber(broker, "r/#", "%U %p");
  DeliveryRig gateway(settings_for(broker.link_port()));
  ASSERT_TRUE(gateway.sees([&] { return gateway.is_up; }));
  constexpr std::uint64_t stall_ms = 25000;
  std::uint64_t last = 0;
  const auto talk_for = [&](std::uint64_t time_ms) {
    const std::uint64_t end = unix_ms() + time_ms;
    gateway.sees([&] {
      if (unix_ms() - last >= 100)
        gateway.submit("r/1/update", last = unix_ms(), Qos::at_most_once);
      return unix_ms() >= end;
    });
  };
  talk_for(2000);
  const std::uint64_t stalled = unix_ms();
  broker.pause();
  talk_for(stall_ms);
  const std::uint64_t resumed = unix_ms();
  broker.resume();
  ASSERT_TRUE(gateway.sees([&] {
    talk_for(100);
    return gateway.is_up && !subscriber.lines().empty() &&
           std::strtoull(subscriber.lines().back().c_str() + 21, nullptr, 10) > resumed;
  }));
  std::size_t late = 0;
  std::uint64_t last_late = 0;
  for (const std::string& line : subscriber.lines()) {
    char* rest = nullptr;
    const auto arrived_ms = static_cast<std::uint64_t>(std::strtod(line.c_str(), &rest) * 1000);
    const std::uint64_t sent_ms = std::strtoull(rest, nullptr, 10);
    if (arrived_ms < sent_ms + 10500) continue;
    ++late;
    last_late = std::max(last_late, sent_ms);
  }
  EXPECT_GE(gateway.silences, 1u);
  // StallWatch: a second until it asks, two until nothing more is sent.
  EXPECT_TRUE(late == 0 || last_late < stalled + 4000)
      << late << " came late, the last was sent " << last_late - stalled << " ms into the stall";
}

}  // namespace
}  // namespace slamgw
