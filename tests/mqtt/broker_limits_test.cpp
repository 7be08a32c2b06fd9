// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/broker_limits.hpp"

#include <gtest/gtest.h>

namespace slamgw {
namespace {

BrokerMessage message_of(std::size_t payload_bytes, Qos qos) {
  return {"t/1", Bytes(payload_bytes, 'x'), qos, false, std::nullopt};
}

TEST(BrokerLimits, DescribeTheirRestrictionsForOperators) {
  EXPECT_EQ(to_words({}), "");
  EXPECT_EQ(to_words({20, 500, Qos::at_least_once, false}),
            "packets up to 500 octets, QoS up to 1, no retained messages");
}

TEST(BrokerLimits, CountThePacketAsItIsOnTheWire) {
  // MQTT 3.1.1 section 3.3: 30 06 00 03 t / 1 x
  EXPECT_EQ(publish_packet_bytes(message_of(1, Qos::at_most_once), std::nullopt), 8u);
  EXPECT_EQ(publish_packet_bytes(message_of(1, Qos::at_least_once), std::nullopt), 10u);
  EXPECT_EQ(publish_packet_bytes(message_of(1, Qos::at_least_once), 0), 11u) << "MQTT 5";
  // The remaining length takes a second octet from 128 on (MQTT 5 section 1.5.5).
  EXPECT_EQ(publish_packet_bytes(message_of(122, Qos::at_most_once), std::nullopt), 129u);
  EXPECT_EQ(publish_packet_bytes(message_of(123, Qos::at_most_once), std::nullopt), 131u);
  EXPECT_EQ(publish_packet_bytes(message_of(0, Qos::at_most_once), 128), 1 + 2 + 5 + 2 + 128u);
}

}  // namespace
}  // namespace slamgw
