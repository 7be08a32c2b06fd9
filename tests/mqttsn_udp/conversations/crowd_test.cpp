// SPDX-License-Identifier: Apache-2.0
// When all places are taken, clients that have not shown that they receive are evicted.
#include <gtest/gtest.h>

#include "adapters/mqttsn_udp/limits.hpp"
#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

using std::to_string;

Settings small() {
  Settings settings;
  settings.max_clients = 100;
  return settings;
}

Connect connect(const std::string& id, std::uint16_t duration_s, bool is_clean = false) {
  return {false, is_clean, 1, duration_s, id};
}

/// Takes all places from one address, with a CONNECT for each.
void fill(SnRig& rig, unsigned from, std::uint16_t duration_s) {
  for (unsigned i = 0; i < 120; ++i) rig.send(from, connect("x" + to_string(i), duration_s));
  // Each is the client at that address until the next CONNECT.
  rig.sent_to(from);
}

/// Takes all places behind one forwarder, where each client has its own node id.
void fill_nodes(SnRig& rig, unsigned from, std::uint16_t duration_s) {
  for (unsigned i = 0; i < 120; ++i) {
    const std::string id = "x" + to_string(i);
    rig.send_octets(from, encode_encapsulation(0, id, encode(connect(id, duration_s))));
  }
  rig.sent_to(from);
}

std::string answer_to_new(SnRig& rig, unsigned from) {
  rig.sent_to(from);
  rig.send(from, connect("honest", 60));
  const Lines lines = rig.sent_to(from);
  return lines.empty() ? "nothing" : lines.back();
}

TEST(Crowd, EvictsUnprovenClientsOfOneAddressAtOnce) {
  for (const std::uint16_t duration_s : {std::uint16_t{1}, std::uint16_t{60000}}) {
    SnRig rig(small());
    fill(rig, 9, duration_s);
    EXPECT_EQ(answer_to_new(rig, 1), "CONNACK code=0") << duration_s;
    SnRig nodes(small());
    fill_nodes(nodes, 9, duration_s);
    EXPECT_EQ(answer_to_new(nodes, 1), "CONNACK code=0") << duration_s;
    EXPECT_GT(nodes.counter("clients_evicted"), 0U);
    ASSERT_FALSE(nodes.evicted.empty());
    EXPECT_EQ(nodes.gateway.presence_of(nodes.evicted.back().robot), std::nullopt);
  }
}

TEST(Crowd, EvictsUnprovenClientsForAnotherNetwork) {
  SnRig rig(small());
  for (unsigned i = 0; i < 120; ++i) rig.send(10 + i, connect("x" + to_string(i), 60000));
  rig.send(1, SearchGw{1});
  EXPECT_TRUE(rig.is_silent(1)) << "a CONNECT from that network would get no place";
  rig.send(SnRig::first_ipv4 + 1, SearchGw{1});
  EXPECT_EQ(rig.last_to(SnRig::first_ipv4 + 1), "GWINFO gw=1 address=");
  EXPECT_EQ(answer_to_new(rig, 1), "nothing") << "its /64 has most of the places itself";
  EXPECT_EQ(answer_to_new(rig, SnRig::first_ipv4 + 1), "CONNACK code=0");
}

TEST(Crowd, EvictsUnprovenClientsAfterTenSeconds) {
  SnRig rig(small());
  for (unsigned i = 0; i < 120; ++i) rig.send(10 + i, connect("x" + to_string(i), 60000));
  rig.pass_s(10);
  EXPECT_EQ(answer_to_new(rig, 1), "CONNACK code=0");
}

TEST(Crowd, NeverEvictsConnectedClientsThatHaveAnswered) {
  SnRig rig(small());
  for (unsigned i = 0; i < 100; ++i) rig.prove(10 + i, "r" + to_string(i), 60000);
  rig.pass_s(60);
  rig.send(1, SearchGw{1});
  EXPECT_TRUE(rig.is_silent(1));
  EXPECT_EQ(answer_to_new(rig, SnRig::first_ipv4 + 1), "nothing");
  EXPECT_EQ(rig.counter("clients_evicted"), 0U);
}

TEST(Crowd, KeepsAProvenClientForADayAfterItDisconnects) {
  SnRig rig(small());
  for (unsigned i = 0; i < small().max_clients; ++i) {
    rig.prove(10 + i, "r" + to_string(i), 60000);
    rig.send(10 + i, Disconnect{});
  }
  rig.pass(limits::min_absence - std::chrono::minutes(1));
  EXPECT_EQ(answer_to_new(rig, 1), "nothing");
  rig.pass(std::chrono::minutes(2));
  EXPECT_EQ(answer_to_new(rig, 1), "CONNACK code=0");
}

TEST(Crowd, ReportsTheNetworkWithMostClients) {
  SnRig rig(small());
  EXPECT_EQ(rig.gateway.places().most_unproven.clients, 0U);
  rig.prove(1, "r1", 60000);
  for (unsigned i = 0; i < 20; ++i) rig.send(10 + i, connect("x" + to_string(i), 60000));
  MeshPlaces places = rig.gateway.places();
  EXPECT_EQ(places.max, small().max_clients);
  EXPECT_EQ(places.taken, 21U);
  EXPECT_EQ(places.unproven, 20U);
  EXPECT_EQ(places.most_unproven.address, "fd00::/64");
  EXPECT_EQ(places.most_unproven.clients, 20U);
  EXPECT_EQ(places.most.address, "fd00::/64");
  EXPECT_EQ(places.most.clients, 21U) << "includes the proven client";
  rig.prove(10, "x0", 60000);
  EXPECT_EQ(rig.gateway.places().unproven, 19U);
}

TEST(Crowd, EvictsUnprovenClientsAfterARestart) {
  SnRig before(small());
  fill_nodes(before, 9, 60000);
  SnRig after(small());
  for (unsigned i = 0; i < 120; ++i) {
    if (const auto kept = before.gateway.snapshot("x" + to_string(i), before.now))
      after.gateway.restore(*kept, after.now);
  }
  EXPECT_EQ(answer_to_new(after, 1), "CONNACK code=0");
}

/// The key counts as an answer, even if the first message is unexpected.
TEST(Crowd, KeepsThePlaceOfARobotThatProvesItsKey) {
  Settings settings;
  settings.max_clients = 1;
  SnRig rig(settings);
  rig.use_keys({"r1"});
  rig.connect(1, "r1", false, 60000);
  rig.proven[2] = "r1";
  rig.send(2, WillMsg{});
  rig.pass(limits::crowd_patience);
  rig.send(3, connect("x", 60));
  EXPECT_EQ(rig.gateway.presence_of("r1"), Presence::online);
}

TEST(Crowd, RemovesTheSessionOfAForgottenRobot) {
  SnRig rig(small());
  rig.connect(1, "r1", false);
  rig.send(1, Disconnect{});
  ASSERT_TRUE(rig.gateway.snapshot("r1", rig.now));
  rig.gateway.forget("r1", rig.now);
  EXPECT_FALSE(rig.gateway.snapshot("r1", rig.now));
}

}  // namespace
}  // namespace slamgw::mqttsn
