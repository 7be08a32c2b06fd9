// SPDX-License-Identifier: Apache-2.0
#include "daemon/sessions/neighbours.hpp"

#include <gtest/gtest.h>

namespace slamgw::sessions {
namespace {

using std::chrono::seconds;

class NeighboursOfRoomB : public testing::Test {
 protected:
  std::vector<Neighbours::Orphan> state(const std::string& gateway, const std::string& text) {
    return neighbours.on_state(gateway, to_bytes(text));
  }
  void shows(const std::string& gateway, const std::string& robot,
             const std::string& text = R"({"state":"online","since":"2026-11-23T10:00:00Z"})") {
    neighbours.on_presence(gateway, robot, to_bytes(text));
  }
  static constexpr const char* online = R"({"state":"online","connected":"2026-11-23T09:00:00Z"})";
  static constexpr const char* offline = R"({"state":"offline"})";
  Neighbours neighbours{"room-b"};
};

TEST_F(NeighboursOfRoomB, LivingGatewayServesTheRobotsThatItShows) {
  shows("room-a", "r1");
  EXPECT_FALSE(neighbours.is_served_elsewhere("r1"))
      << "room-a has not published that it is online";
  state("room-a", online);
  EXPECT_TRUE(neighbours.is_served_elsewhere("r1"));
  EXPECT_FALSE(neighbours.is_served_elsewhere("r2"));
  neighbours.on_presence("room-a", "r1", {});
  EXPECT_FALSE(neighbours.is_served_elsewhere("r1"));
}

/// A gateway that answers for another's robots shows them as offline.
TEST_F(NeighboursOfRoomB, AcceptsPresenceFromAGatewayThatAnswersForADeadOne) {
  state("room-a", online);
  state("room-c", online);
  shows("room-c", "r1");
  state("room-c", offline);
  shows("room-a", "r1", offline);
  EXPECT_TRUE(neighbours.is_served_elsewhere("r1"));
  neighbours.on_presence("room-c", "r1", {});
  EXPECT_TRUE(neighbours.is_served_elsewhere("r1"));
  EXPECT_FALSE(neighbours.is_heard_elsewhere("r1"));
}

TEST_F(NeighboursOfRoomB, AreForgottenAtAnotherBroker) {
  state("room-a", online);
  shows("room-a", "r1");
  EXPECT_FALSE(neighbours.is_first());
  neighbours.on_broker_up(/*is_other=*/true);
  EXPECT_TRUE(neighbours.is_first());
  EXPECT_FALSE(neighbours.is_served_elsewhere("r1"));
}

/// A broker lost its retained messages, and a gateway died with it.
TEST_F(NeighboursOfRoomB, GatewayWithoutARetainedStateAfterReconnectIsDead) {
  for (const char* const each : {"room-a", "room-c"}) state(each, online);
  shows("room-a", "r1");
  shows("room-c", "r2");
  neighbours.on_broker_up(/*is_other=*/false);
  state("room-c", online);
  EXPECT_TRUE(neighbours.is_served_elsewhere("r1")) << "its retained state may still arrive";
  neighbours.on_settled();
  EXPECT_FALSE(neighbours.is_served_elsewhere("r1"));
  EXPECT_TRUE(neighbours.is_served_elsewhere("r2"));
  ASSERT_EQ(neighbours.orphans().size(), 1U);
  EXPECT_EQ(neighbours.orphans()[0].robot, "r1");
}

/// It shows itself again only to gateways that it saw leave, so its silence means nothing.
TEST_F(NeighboursOfRoomB, GatewayOfVersion010LivesUntilItsLastWill) {
  state("room-a", R"({"state":"online","version":"0.1.0","since":"2026-11-23T09:00:00Z"})");
  shows("room-a", "r1");
  neighbours.on_broker_up(/*is_other=*/false);
  neighbours.on_settled();
  EXPECT_TRUE(neighbours.is_served_elsewhere("r1"));
  state("room-a", offline);
  EXPECT_FALSE(neighbours.is_served_elsewhere("r1"));
}

TEST_F(NeighboursOfRoomB, IgnoresItsOwnMessages) {
  state("room-b", online);
  shows("room-b", "r1");
  EXPECT_FALSE(neighbours.is_served_elsewhere("r1"));
  EXPECT_TRUE(neighbours.gateways().empty());
}

TEST_F(NeighboursOfRoomB, Rule7_ReturnsTheRobotsOfADeadGatewayAsOrphansOnce) {
  state("room-a", online);
  state("room-aa", online);
  state("room-c", online);
  shows("room-c", "r1");
  shows("room-a", "r2");
  const auto orphans = state("room-c", offline);
  ASSERT_EQ(orphans.size(), 1U);
  EXPECT_EQ(orphans[0].robot, "r1");
  EXPECT_EQ(orphans[0].after, seconds{5} + seconds{2})
      << "two living gateways come before it by name";
  EXPECT_TRUE(state("room-c", offline).empty());
}

TEST_F(NeighboursOfRoomB, ReturnsTheRobotsOfAGatewayThatWasAlreadyOffline) {
  shows("room-c", "r1");
  EXPECT_TRUE(state("room-c", offline).empty());
  ASSERT_EQ(neighbours.orphans().size(), 1U);
  EXPECT_EQ(neighbours.orphans()[0].robot, "r1");
  state("room-c", online);
  EXPECT_TRUE(neighbours.orphans().empty());
}

TEST_F(NeighboursOfRoomB, GatewayThatShowsARobotAsOfflineHasNotHeardIt) {
  state("room-a", online);
  shows("room-a", "r1", offline);
  EXPECT_TRUE(neighbours.is_served_elsewhere("r1"));
  EXPECT_FALSE(neighbours.is_heard_elsewhere("r1"));
  shows("room-a", "r1", R"({"state":"asleep"})");
  EXPECT_TRUE(neighbours.is_heard_elsewhere("r1"));
}

TEST_F(NeighboursOfRoomB, LatePresenceOfAFormerGatewayDoesNotHideTheCurrentOne) {
  state("room-a", online);
  state("room-c", online);
  shows("room-a", "r1");
  shows("room-c", "r1");
  shows("room-a", "r1");
  neighbours.on_presence("room-a", "r1", {});
  ASSERT_TRUE(neighbours.robots().contains("r1"));
  EXPECT_EQ(neighbours.robots().at("r1").gateway, "room-c");
  neighbours.on_presence("room-c", "r1", {});
  EXPECT_FALSE(neighbours.robots().contains("r1"));

  shows("room-a", "r1");
  shows("room-c", "r1");
  neighbours.on_presence("room-a", "r1", {});
  neighbours.on_presence("room-c", "r1", {});
  EXPECT_FALSE(neighbours.robots().contains("r1")) << "room-a has withdrawn it, too";

  shows("room-a", "r1");
  shows("room-c", "r1");
  state("room-a", offline);
  neighbours.on_presence("room-c", "r1", {});
  EXPECT_FALSE(neighbours.robots().contains("r1")) << "room-a is gone";
}

TEST_F(NeighboursOfRoomB, TakesThePresenceOfTheGatewayThatHeardTheRobotLast) {
  state("room-a", online);
  state("room-c", online);
  shows("room-a", "r1");
  shows("room-c", "r1", offline);
  EXPECT_EQ(neighbours.robots().at("r1").gateway, "room-a");
  shows("room-c", "r1");
  EXPECT_EQ(neighbours.robots().at("r1").gateway, "room-c");
  neighbours.on_presence("room-a", "r1", {});
  EXPECT_TRUE(neighbours.is_served_elsewhere("r1"));
}

TEST_F(NeighboursOfRoomB, Rule8_FirstLivingGatewayByNameRefusesUnknownRobots) {
  EXPECT_TRUE(neighbours.is_first());
  state("room-c", online);
  EXPECT_TRUE(neighbours.is_first());
  state("room-a", online);
  EXPECT_FALSE(neighbours.is_first());
  state("room-a", offline);
  EXPECT_TRUE(neighbours.is_first());
}

TEST_F(NeighboursOfRoomB, IgnoresMalformedDocuments) {
  for (const char* text :
       {"{", "[]", "7", R"({"state":7})", R"({"state":{"toString":1}})", "null"}) {
    EXPECT_TRUE(state("room-a", text).empty());
    shows("room-a", "r1", text);
    EXPECT_FALSE(neighbours.is_served_elsewhere("r1")) << text;
  }
  state("room-a", R"({"state":"online","version":"0","x":")" + std::string(5000, 'x') + "\"}");
  EXPECT_FALSE(neighbours.gateways().at("room-a").is_online);
}

TEST_F(NeighboursOfRoomB, InventedGatewaysAndRobotsAreBounded) {
  for (std::size_t i = 0; i < Neighbours::max_gateways + 10; ++i)
    state("g" + std::to_string(i), online);
  for (std::size_t i = 0; i < Neighbours::max_robots + 10; ++i) shows("g1", std::to_string(i));
  EXPECT_EQ(neighbours.gateways().size(), Neighbours::max_gateways);
  EXPECT_EQ(neighbours.robots().size(), Neighbours::max_robots);
}

}  // namespace
}  // namespace slamgw::sessions
