// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/hot_path.hpp"

#include <gtest/gtest.h>

#include "adapters/mqttsn_udp/clients/delivery.hpp"
#include "tests/bench/allocations.hpp"

namespace slamgw::bench {
namespace {

using namespace std::chrono_literals;

/// Each client sends ten messages a second.
constexpr std::uint16_t clients = 10;
constexpr auto between = 10ms;
/// Tables of recent messages have reached their full size after this many.
constexpr int until_warm = 5000;
constexpr int measured = 1000;

TEST(HotPath, AllocatesNothingForAMessageOfQos0) {
  HotPath path(clients, between);
  for (int i = 0; i < until_warm; ++i) path.publish(Qos::at_most_once);
  path.forget_allocations();
  const std::uint64_t before = path.at_broker();
  for (int i = 0; i < measured; ++i) path.publish(Qos::at_most_once);
  EXPECT_EQ(path.at_broker() - before, measured);
  EXPECT_EQ(path.allocations(), 0u);
}

TEST(HotPath, AllocatesNothingForAMessageOfQos1AndItsPuback) {
  HotPath path(clients, between);
  for (int i = 0; i < until_warm; ++i) path.publish(Qos::at_least_once);
  path.forget_allocations();
  const std::uint64_t at_broker = path.at_broker();
  const std::uint64_t pubacks = path.sent_datagrams();
  for (int i = 0; i < measured; ++i) path.publish(Qos::at_least_once);
  EXPECT_EQ(path.at_broker() - at_broker, measured);
  EXPECT_EQ(path.sent_datagrams() - pubacks, measured);
  EXPECT_EQ(path.allocations(), 0u);
}

TEST(HotPath, AnswersAPingWithoutTheBrokerAndTheDisk) {
  HotPath path(clients, between);
  const std::uint64_t at_broker = path.at_broker();
  const std::uint64_t at_disk = path.at_disk();
  EXPECT_EQ(at_broker, clients);     // presence
  EXPECT_EQ(at_disk, 3u * clients);  // sessions: CONNECT, REGISTER, SUBSCRIBE
  const std::uint64_t before = path.sent_datagrams();
  for (int i = 0; i < measured; ++i) path.ping();
  EXPECT_EQ(path.sent_datagrams() - before, measured);
  EXPECT_EQ(path.at_broker(), at_broker);
  EXPECT_EQ(path.at_disk(), at_disk);
}

TEST(HotPath, AllocatesNothingForAPing) {
  HotPath path(clients, between);
  for (int i = 0; i < until_warm; ++i) path.ping();
  path.forget_allocations();
  const std::uint64_t pingresps = path.sent_datagrams();
  for (int i = 0; i < measured; ++i) path.ping();
  EXPECT_EQ(path.sent_datagrams() - pingresps, measured);
  EXPECT_EQ(path.allocations(), 0u);
}

/// Its text is in a log line, an outcome and the message to the mesh; commands are rare.
TEST(HotPath, AllocatesAtMost21TimesForACommandAndItsOutcome) {
  HotPath path(clients, between);
  for (int i = 0; i < until_warm; ++i) path.command();
  path.forget_allocations();
  const std::uint64_t outcomes = path.at_broker();
  for (int i = 0; i < measured; ++i) path.command();
  EXPECT_EQ(path.at_broker() - outcomes, measured);
  EXPECT_LE(path.allocations() / measured, 21u);
}

TEST(HotPath, FreesTheMemoryOfMessagesThatHaveLeftAClientsQueue) {
  mqttsn::DeliveryQueue queue;
  mqttsn::Outgoing message;
  message.message = std::make_shared<const BrokerMessage>();
  const std::uint64_t before = octets_in_use();
  for (int i = 0; i < 100; ++i) queue.push_back(message);
  EXPECT_GT(octets_in_use(), before);
  while (!queue.empty()) mqttsn::take(queue, 0);
  EXPECT_EQ(octets_in_use(), before);
}

/// Without its robot's session at the broker.
TEST(HotPath, TakesAtMost2560OctetsForAnIdleClient) {
  const auto octets_with = [](std::uint16_t all) {
    const std::uint64_t before = octets_in_use();
    const HotPath path(all, between);
    return octets_in_use() - before;
  };
  constexpr std::uint16_t more = 1000;
  EXPECT_LE((octets_with(clients + more) - octets_with(clients)) / more, 2560u);
}

}  // namespace
}  // namespace slamgw::bench
