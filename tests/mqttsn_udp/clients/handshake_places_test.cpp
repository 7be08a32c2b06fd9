// SPDX-License-Identifier: Apache-2.0
// A flood of unfinished handshakes takes no place from a robot.
#include "adapters/mqttsn_udp/clients/handshake_places.hpp"

#include <gtest/gtest.h>

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

class HandshakePlaces : public testing::Test {
 protected:
  /// Begins a handshake. Returns the handshake that was ended to make room.
  std::optional<Endpoint> add(const Endpoint& from) {
    const auto gone = find_handshake_to_end(under_way, from.address);
    if (gone) under_way.erase(*gone);
    under_way[from] = {now += std::chrono::milliseconds(1)};
    return gone;
  }

  struct Handshake {
    TimePoint began;
  };
  std::map<Endpoint, Handshake> under_way;
  TimePoint now{std::chrono::hours(1)};
};

TEST_F(HandshakePlaces, AreBoundedForEachAddress) {
  for (unsigned port = 0; port < 1000; ++port) {
    const auto gone = add(endpoint(1, 1, port));
    ASSERT_EQ(gone.has_value(), port >= limits::max_dtls_handshakes_of_address);
    if (gone) {
      EXPECT_EQ(gone->port, port - limits::max_dtls_handshakes_of_address) << "the oldest is ended";
    }
  }
  EXPECT_EQ(under_way.size(), limits::max_dtls_handshakes_of_address);
}

TEST_F(HandshakePlaces, KeepARobotsHandshakeDuringAFloodFromItsNetwork) {
  const Endpoint robot = endpoint(1, 0xffff, 1);
  EXPECT_FALSE(add(robot));
  constexpr unsigned addresses = limits::max_dtls_handshakes_of_network - 2;
  for (unsigned i = 0; i < 2000; ++i)
    ASSERT_FALSE(add(endpoint(1, i % addresses, i)) == robot) << "other addresses have more";
  EXPECT_EQ(under_way.size(), limits::max_dtls_handshakes_of_network);
}

TEST_F(HandshakePlaces, AreBoundedForAllNetworksTogether) {
  const Endpoint robot = endpoint(0x100, 1, 1);
  EXPECT_FALSE(add(robot));
  for (unsigned i = 0; i < 2000; ++i) {
    ASSERT_FALSE(add(endpoint(i % 100, i % 200 / 100, i)) == robot);
    ASSERT_LE(under_way.size(), limits::max_dtls_handshakes);
  }
  EXPECT_TRUE(under_way.contains(robot));
}

TEST_F(HandshakePlaces, ExpireAfterTheTimeLimit) {
  add(endpoint(1, 1, 1));
  const TimePoint end = now + limits::dtls_handshake_patience;
  now += std::chrono::seconds(1);
  add(endpoint(1, 1, 2));
  EXPECT_FALSE(find_overdue_handshake(under_way, end - std::chrono::milliseconds(1)));
  EXPECT_EQ(find_overdue_handshake(under_way, end), endpoint(1, 1, 1));
  under_way.erase(endpoint(1, 1, 1));
  EXPECT_FALSE(find_overdue_handshake(under_way, end));
}

}  // namespace
}  // namespace slamgw::mqttsn
