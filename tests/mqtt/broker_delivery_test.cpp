// SPDX-License-Identifier: Apache-2.0
// Outbox and store over a broker link to a real Mosquitto that is killed, or refuses.
#include <gtest/gtest.h>

#include <algorithm>
#include <string>
#include <vector>

#include "tests/mqtt/delivery_rig.hpp"
#include "tests/support/mosquitto.hpp"

namespace slamgw {
namespace {

using test::Mosquitto;
using test::Subscriber;

std::vector<std::string> numbers(std::uint64_t first, std::uint64_t count) {
  std::vector<std::string> out;
  for (std::uint64_t i = 0; i < count; ++i) out.push_back(std::to_string(first + i));
  return out;
}

/// Returns the lines in the order of their first arrival. Messages in flight at a break repeat.
std::vector<std::string> without_repeats(const std::vector<std::string>& lines) {
  std::vector<std::string> once;
  for (const std::string& line : lines) {
    if (std::find(once.begin(), once.end(), line) == once.end()) once.push_back(line);
  }
  return once;
}

using BrokerDelivery = WithEachClientAndVersion;
INSTANTIATE_TEST_SUITE_P(Over, BrokerDelivery, testing::Combine(each_client, either_version),
                         BrokerDelivery::name);
using BrokerRefusal = WithEachClient;
INSTANTIATE_TEST_SUITE_P(Over, BrokerRefusal, each_client, BrokerRefusal::name);
using BrokerLimit = WithEachClient;
INSTANTIATE_TEST_SUITE_P(Over, BrokerLimit, each_client, BrokerLimit::name);

TEST_P(BrokerDelivery, LosesNothingThatWasInFlightWhenTheBrokerIsKilled) {
  BrokerOfVersion broker(version());
  DeliveryRig gateway(settings_for(broker.link_port()));
  ASSERT_TRUE(gateway.sees([&] { return gateway.is_up; }));
  std::vector<std::string> received;
  std::uint64_t number = 0;
  for (int round = 0; round < 3; ++round) {
    const Subscriber subscriber(broker, "t", "%p");
    broker.pause();  // messages published from here on are in flight when it is killed
    for (int i = 0; i < 100; ++i) gateway.submit("t", ++number);
    broker.kill();
    ASSERT_TRUE(gateway.sees([&] { return !gateway.is_up; })) << round;
    for (int i = 0; i < 100; ++i) gateway.submit("t", ++number);
    ASSERT_TRUE(gateway.sees([&] { return gateway.fired.size() == number; })) << "on disk";
    broker.start();
    const Subscriber again(broker, "t", "%p");
    ASSERT_TRUE(gateway.sees([&] { return gateway.depth() == 0; }));
    ASSERT_TRUE(gateway.sees([&] { return again.lines().size() >= 200; }));
    for (const std::string& line : again.lines()) received.push_back(line);
  }
  EXPECT_EQ(without_repeats(received), numbers(1, number));
  EXPECT_EQ(gateway.outbox.statistics().refused, 0u);
  for (const std::string& reason : gateway.reasons)
    EXPECT_EQ(reason.find("0xff"), std::string::npos) << reason;
}

/// A real broker takes a message of QoS 2 a round trip after its PUBLISH.
TEST_P(BrokerDelivery, KeepsTheOrderOfATopicAcrossQos) {
  BrokerOfVersion broker(version());
  const Subscriber subscriber(broker, "t", "%p");
  DeliveryRig gateway(settings_for(broker.link_port()));
  for (std::uint64_t number = 1; number <= 30; ++number)
    gateway.submit("t", number, number % 3 == 2 ? Qos::exactly_once : Qos::at_least_once);
  ASSERT_TRUE(gateway.sees([&] { return subscriber.lines().size() >= 30; }));
  EXPECT_EQ(subscriber.lines(), numbers(1, 30));
}

TEST_P(BrokerDelivery, LosesNothingWhenItMovesToTheNextBroker) {
  BrokerOfVersion first(version());
  BrokerOfVersion second(version());
  BrokerSettings settings = settings_for(first.link_port());
  settings.others = {{"127.0.0.1", second.link_port(), false}};
  DeliveryRig gateway(settings);
  ASSERT_TRUE(gateway.sees([&] { return gateway.is_up; }));
  const Subscriber subscriber(second, "t", "%p");
  first.pause();  // it acknowledges nothing any more
  for (std::uint64_t i = 1; i <= 100; ++i) gateway.submit("t", i);
  first.kill();
  ASSERT_TRUE(gateway.sees([&] { return gateway.fired.size() == 100; }));
  ASSERT_TRUE(gateway.sees([&] { return without_repeats(subscriber.lines()).size() == 100; }));
  EXPECT_EQ(without_repeats(subscriber.lines()), numbers(1, 100));
  EXPECT_EQ(gateway.outbox.statistics().refused, 0u);
}

TEST_P(BrokerRefusal, RefusedMessagesWaitUntilTheAccessListIsCorrected) {
  test::TempDir directory;
  const std::string access = directory / "access";
  test::write_file(access, "topic readwrite r/1/#\ntopic read r/2/#\ntopic readwrite gw/#\n");
  Mosquitto broker("acl_file " + access);
  const Subscriber subscriber(broker, "r/#", "%t %p");
  DeliveryRig gateway(settings_for(broker.port()));
  ASSERT_TRUE(gateway.sees([&] { return gateway.is_up; }));
  for (std::uint64_t i = 1; i <= 200; ++i) {
    gateway.submit("r/1/update", i);
    gateway.submit("r/2/update", 1000 + i, i % 2 ? Qos::at_least_once : Qos::exactly_once);
  }
  ASSERT_TRUE(gateway.sees([&] { return gateway.fired.size() == 400; })) << "safe on disk";
  for (const auto& [receipt, outcome] : gateway.fired) EXPECT_EQ(outcome, ReceiptOutcome::safe);
  ASSERT_TRUE(gateway.sees([&] { return without_repeats(subscriber.lines()).size() == 200; }));
  ASSERT_TRUE(gateway.sees([&] { return gateway.outbox.refused_topics().count() == 1; }));
  ASSERT_TRUE(gateway.sees([&] {
    const auto refused = gateway.outbox.refused_topics().list(1);
    return refused.size() == 1 && refused[0].tries >= 2;
  }));
  EXPECT_TRUE(gateway.logs("refuses messages on r/2/update: not authorised (0x87)"));

  test::write_file(access, "topic readwrite #\n");
  broker.reload();
  ASSERT_TRUE(gateway.sees([&] { return gateway.depth() == 0; }));
  ASSERT_TRUE(gateway.sees([&] { return without_repeats(subscriber.lines()).size() == 400; }));
  std::vector<std::string> expected = numbers(1001, 200);
  for (std::string& line : expected) line = "r/2/update " + line;
  std::vector<std::string> refused = without_repeats(subscriber.lines());
  std::erase_if(refused, [](const std::string& line) { return line.starts_with("r/1/"); });
  EXPECT_TRUE(std::ranges::is_permutation(refused, expected)) << "each once, in any order";
  EXPECT_TRUE(gateway.logs("accepts messages on r/2/update again"));
}

TEST_P(BrokerLimit, MakesADeadLetterOfATooLargeMessageAndDeliversOthers) {
  Mosquitto broker("max_packet_size 500");
  const Subscriber subscriber(broker, "r/#", "%t");
  DeliveryRig gateway(settings_for(broker.port()));
  ASSERT_TRUE(gateway.sees([&] { return gateway.is_up; }));
  gateway.submit("r/1/update", 1);
  gateway.submit_bytes("r/1/update", Bytes(600, 'x'), 2);
  gateway.submit_bytes("r/1/often", Bytes(600, 'x'), 0, Qos::at_most_once);
  gateway.submit("r/1/update", 3);
  gateway.submit("r/2/update", 4);
  ASSERT_TRUE(gateway.sees([&] { return gateway.fired.size() == 4; }));
  ASSERT_TRUE(gateway.sees([&] { return subscriber.lines().size() == 3; }));
  ASSERT_TRUE(gateway.sees([&] { return gateway.depth() == 0; }));
  for (const auto& [receipt, outcome] : gateway.fired) EXPECT_EQ(outcome, ReceiptOutcome::safe);
  EXPECT_EQ(gateway.ups, 1u) << "it was never sent";
  EXPECT_EQ(gateway.outbox.backlog().dead_letters().count, 1u);
  EXPECT_EQ(gateway.outbox.statistics().dropped, 1u);
  EXPECT_TRUE(gateway.logs("is a dead letter now: the packet of"));
  EXPECT_TRUE(gateway.logs("messages of QoS 0 on r/1/often are dropped"));
}

}  // namespace
}  // namespace slamgw
