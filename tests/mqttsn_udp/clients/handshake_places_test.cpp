// SPDX-License-Identifier: Apache-2.0
// Handshakes that never end take no place from a robot, however many they are.
#include "adapters/mqttsn_udp/clients/handshake_places.hpp"

#include <gtest/gtest.h>

#include <set>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {
namespace {

Endpoint endpoint(unsigned network, unsigned host, unsigned port) {
  Endpoint out;
  out.address = {0xfd, 0, static_cast<std::uint8_t>(network >> 8),
                 static_cast<std::uint8_t>(network)};
  out.address[14] = static_cast<std::uint8_t>(host >> 8);
  out.address[15] = static_cast<std::uint8_t>(host);
  out.port = static_cast<std::uint16_t>(port);
  return out;
}

const TimePoint start{std::chrono::hours(1)};

TEST(HandshakePlaces, AreBoundedAtAnAddress) {
  HandshakePlaces places;
  for (unsigned port = 0; port < 1000; ++port) {
    const auto gone = places.add(endpoint(1, 1, port), start);
    ASSERT_EQ(gone.has_value(), port >= limits::max_dtls_handshakes_of_address);
    if (gone) {
      EXPECT_EQ(gone->port, port - limits::max_dtls_handshakes_of_address) << "the oldest";
    }
  }
  EXPECT_EQ(places.size(), limits::max_dtls_handshakes_of_address);
}

TEST(HandshakePlaces, OfARobotAreLeftByAFloodFromItsOwnNetwork) {
  HandshakePlaces places;
  const Endpoint robot = endpoint(1, 0xffff, 1);
  EXPECT_FALSE(places.add(robot, start));
  for (unsigned i = 0; i < 10000; ++i) {
    const auto gone = places.add(endpoint(1, i % 60, i), start);
    ASSERT_FALSE(gone == robot) << "others have more";
  }
  EXPECT_EQ(places.size(), limits::max_dtls_handshakes_of_network);
}

TEST(HandshakePlaces, OfAllNetworksAreBounded) {
  HandshakePlaces places;
  const Endpoint robot = endpoint(0x100, 1, 1);
  EXPECT_FALSE(places.add(robot, start));
  for (unsigned i = 0; i < 10000; ++i) {
    const auto gone = places.add(endpoint(i % 100, i % 200 / 100, i), start);
    ASSERT_FALSE(gone == robot);
    ASSERT_LE(places.size(), limits::max_dtls_handshakes);
  }
  places.remove(robot);
  EXPECT_EQ(places.size(), limits::max_dtls_handshakes - 1);
}

TEST(HandshakePlaces, EndWithTime) {
  HandshakePlaces places;
  places.add(endpoint(1, 1, 1), start);
  places.add(endpoint(1, 1, 2), start + std::chrono::seconds(1));
  const TimePoint end = start + limits::dtls_handshake_patience;
  EXPECT_FALSE(places.take_overdue(end - std::chrono::milliseconds(1)));
  EXPECT_EQ(places.take_overdue(end), endpoint(1, 1, 1));
  EXPECT_FALSE(places.take_overdue(end));
  EXPECT_EQ(places.size(), 1U);
}

}  // namespace
}  // namespace slamgw::mqttsn
