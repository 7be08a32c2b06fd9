// SPDX-License-Identifier: Apache-2.0
// Which client gets a place, which connection yields, and which addresses count as one client.
#include "web/server/places.hpp"

#include <arpa/inet.h>
#include <gtest/gtest.h>

#include <array>
#include <vector>

namespace slamgw::web::test {
namespace {

Client client_at(const char* text) {
  std::array<unsigned char, 16> octets{};
  if (inet_pton(AF_INET, text, octets.data()) == 1) return client_of(std::span(octets).first(4));
  EXPECT_EQ(inet_pton(AF_INET6, text, octets.data()), 1) << text;
  return client_of(octets);
}

TEST(WebClient, IsAnIpv4AddressOrASlash64) {
  EXPECT_EQ(client_at("192.0.2.7").name, "192.0.2.7");
  EXPECT_EQ(client_at("::ffff:192.0.2.7").name, "192.0.2.7");
  EXPECT_EQ(client_at("2001:db8:0:1::7").name, "2001:db8:0:1::/64");
  EXPECT_EQ(client_at("2001:db8:0:1:ffff::").name, "2001:db8:0:1::/64");
  EXPECT_NE(client_at("2001:db8:0:2::7").name, client_at("2001:db8:0:1::7").name);
  for (const char* address : {"127.0.0.1", "127.9.9.9", "::1", "::ffff:127.0.0.1"})
    EXPECT_TRUE(client_at(address).is_loopback) << address;
  for (const char* address : {"128.0.0.1", "::", "::2", "1::1", "::ffff:128.0.0.1"})
    EXPECT_FALSE(client_at(address).is_loopback) << address;
}

class WebPlaces : public testing::Test {
 protected:
  using Room = Places::Room;
  Places places{16};
  std::vector<HeldPlace> held;
  std::string yielded;  ///< names of connections, each with a space
  const Client one = client_at("192.0.2.1");
  const Client loopback = client_at("127.0.0.1");

  void take(const Client& client, int times = 1) {
    for (int i = 0; i < times; ++i) held.push_back(places.take(client));
  }
  HeldPlace take_waiting(const Client& client, const std::string& name) {
    held.push_back(places.take(client));
    places.set_waiting(held.back(), [this, name] { yielded += name + " "; });
    return held.back();
  }
};

TEST_F(WebPlaces, OneAddressMayTakeAQuarter) {
  take(one, 4);
  EXPECT_EQ(places.room_for(one), Room::share_is_taken);
  EXPECT_FALSE(places.make_room_for(one));
  EXPECT_EQ(places.room_for(client_at("192.0.2.2")), Room::free);
  held.pop_back();
  EXPECT_EQ(places.room_for(one), Room::free);
}

TEST_F(WebPlaces, AddressesOfASlash64ShareAQuarter) {
  for (const char* address : {"fd00::1", "fd00::2", "fd00::3", "fd00::ffff:4"})
    take(client_at(address));
  EXPECT_EQ(places.room_for(client_at("fd00::5")), Room::share_is_taken);
  EXPECT_EQ(places.room_for(client_at("fd00:0:0:1::5")), Room::free);
}

TEST_F(WebPlaces, ShareIsNeverBelowTwo) {
  EXPECT_EQ(Places(3).share_of(one), 2u);
  EXPECT_EQ(Places(32).share_of(one), 8u);
  EXPECT_EQ(Places(256).share_of(one), 64u);
}

TEST_F(WebPlaces, LoopbackMayTakeThreeQuartersForProxy) {
  take(loopback, 12);
  EXPECT_EQ(places.room_for(loopback), Room::share_is_taken);
  EXPECT_EQ(places.room_for(one), Room::free);
  EXPECT_FALSE(places.make_room_for(loopback)) << "none of them waits for a request";
}

TEST_F(WebPlaces, LongestWaitingConnectionYieldsWhenAllAreTaken) {
  take(loopback, 13);
  take_waiting(loopback, "first");
  const HeldPlace busy = take_waiting(loopback, "busy");
  const HeldPlace later = take_waiting(loopback, "later");
  places.set_waiting(busy, nullptr);
  EXPECT_TRUE(places.make_room_for(one));
  take(one);
  EXPECT_EQ(yielded, "first ");
  EXPECT_TRUE(places.make_room_for(one));
  take(one);
  EXPECT_EQ(yielded, "first later ");
  EXPECT_FALSE(places.make_room_for(one));
}

TEST_F(WebPlaces, AddressAtItsShareReplacesItsOwnConnection) {
  take_waiting(client_at("192.0.2.2"), "other");
  take_waiting(one, "own");
  take(one, 3);
  EXPECT_TRUE(places.make_room_for(one));
  EXPECT_EQ(yielded, "own ");
  EXPECT_EQ(places.room_for(one), Room::free);
}

TEST_F(WebPlaces, IncompleteRequestsDoNotBlockNewConnection) {
  for (int i = 0; i < 1000; ++i) {
    ASSERT_TRUE(places.make_room_for(loopback));
    take_waiting(loopback, std::to_string(i));
  }
  EXPECT_TRUE(places.make_room_for(one));
}

TEST_F(WebPlaces, YieldedPlaceIsFreedOnce) {
  take(loopback, 15);
  HeldPlace first = take_waiting(loopback, "first");
  EXPECT_TRUE(places.make_room_for(one));
  held.pop_back();
  take(one);
  places.set_waiting(first, [] { FAIL() << "it has no place any more"; });
  first.reset();
  EXPECT_EQ(places.room_for(one), Room::all_are_taken);
  EXPECT_FALSE(places.make_room_for(one));
}

}  // namespace
}  // namespace slamgw::web::test
