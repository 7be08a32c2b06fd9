// SPDX-License-Identifier: Apache-2.0
// Robots that the core forgets leave the fleet, too; and a fleet that knows too many.
#include <fmt/format.h>

#include "tests/fleet/fleet_world.hpp"
#include "tests/fleet/looped_back.hpp"

namespace slamgw::fleet::test {
namespace {

class ForgottenRobots : public LoopedBack {
 protected:
  bool is_known(const std::string& robot) { return ownership.claims().find(robot).has_value(); }
  bool is_served(const std::string& robot) { return ownership.may_act_for(robot, at(now).mono); }
  std::uint64_t counted(const std::string& name) {
    for (const auto& [counter, value] : ownership.counters())
      if (counter == name) return value;
    ADD_FAILURE() << "no counter " << name;
    return 0;
  }
};

/// Clients with invented names connect one after the other, and the core keeps a few of them.
TEST_F(ForgottenRobots, MakeRoomForOthers) {
  for (int i = 0; i < 21'000; ++i) {
    ownership.on_heard(fmt::format("invented-{}", i), at(now));
    if (i % 500 == 499) pass(500ms);
    if (i >= 1000) ownership.on_forgotten(fmt::format("invented-{}", i - 1000));
  }
  pass(500ms);
  EXPECT_EQ(ownership.claims().size(), 1001U);
  EXPECT_EQ(ownership.owned(), 1001U) << "and its own robot";
  ownership.on_heard("new", at(now));
  pass(500ms);
  EXPECT_TRUE(is_served("new"));
  EXPECT_EQ(counted("fleet_claims_not_kept"), 0U);
}

TEST_F(ForgottenRobots, AreClaimedAgainWhenTheyAreHeardAgain) {
  ASSERT_TRUE(is_served("r"));
  ownership.on_forgotten("r");
  EXPECT_FALSE(is_known("r"));
  EXPECT_FALSE(is_served("r"));
  ownership.on_heard("r", at(now));
  pass(500ms);
  EXPECT_TRUE(is_served("r"));
}

TEST_F(ForgottenRobots, AreNotKeptWhenTheyAreWonAfterwards) {
  ownership.on_heard("brief", at(now));
  ownership.on_forgotten("brief");
  ownership.on_heard("back", at(now));
  ownership.on_forgotten("back");
  ownership.on_heard("back", at(now));
  pass(1s);
  EXPECT_FALSE(is_known("brief"));
  EXPECT_FALSE(dead_owners.contains("brief")) << "it is not announced";
  EXPECT_TRUE(is_served("back"));
}

TEST_F(ForgottenRobots, OfOtherGatewaysStayWithThem) {
  beat_of_gw_1(9000);
  ownership.on_fleet_message({"gw-1", 0x20001, ClaimRobot{"x", 7, {}}}, at(now));
  ownership.on_forgotten("x");
  EXPECT_EQ(ownership.place_of("x", at(now).mono)->gateway, "gw-1");
}

/// Its session is here still, and gw-1 has not noticed yet that it was forgotten.
TEST_F(ForgottenRobots, AreHandedOverWithTheirSessions) {
  beat_of_gw_1(9000);
  ownership.on_forgotten("r");
  pass(10ms);
  given_up.clear();
  ownership.on_fleet_message({"gw-1", 0x20001, ClaimRobot{"r", 2, "gw-0"}}, at(now));
  pass(10ms);
  EXPECT_EQ(given_up, std::vector<std::string>{"r"});
  EXPECT_TRUE(releases.empty()) << "with the session only";
  ownership.on_given_up("r", {2, "gw-1", 0x20001}, Bytes{1, 2, 3}, at(now));
  pass(10ms);
  ASSERT_EQ(releases.size(), 1U);
  EXPECT_EQ(releases[0].session, (Bytes{1, 2, 3}));
}

/// The others ask for the table of the gateway whose digest has changed, once.
TEST(ForgottenRobot, LeavesTheTablesOfTheOthersToo) {
  FleetWorld world({.gateways = 3, .robots = 2, .lost = 0});
  const std::string robot = FleetWorld::robot_name(0);
  world.run(5s);
  for (const int place : {1, 2, 0}) {  // its epoch rises
    world.roam(0, place);
    world.run(1s);
  }
  world.silence(0);
  world.ownership(0).on_forgotten(robot);
  world.run(4s);
  for (int gateway = 0; gateway < 3; ++gateway)
    EXPECT_FALSE(world.ownership(gateway).claims().find(robot)) << gateway;
  const auto asked = world.published_by_kind("ask");
  world.run(10s);
  EXPECT_EQ(world.published_by_kind("ask"), asked) << "they agree";
}

/// Before the others have noticed that it was forgotten.
TEST(ForgottenRobot, IsKnownToAllWhenItIsHeardAgainAtOnce) {
  FleetWorld world({.gateways = 3, .robots = 2, .lost = 0});
  world.run(5s);
  for (const int place : {1, 2, 0}) {
    world.roam(0, place);
    world.run(1s);
  }
  world.ownership(0).on_forgotten(FleetWorld::robot_name(0));
  world.run(5s);
  EXPECT_EQ(world.actors(0), std::vector<int>{0});
  const auto asked = world.published_by_kind("ask");
  world.run(10s);
  EXPECT_EQ(world.published_by_kind("ask"), asked) << "they agree";
  world.roam(0, 1);
  world.run(1s);
  EXPECT_EQ(world.actors(0), std::vector<int>{1});
}

TEST(ForgottenRobot, TakesItsSessionAlongWhenItGoesOnAtOnce) {
  FleetWorld world({.gateways = 3, .robots = 2, .lost = 0});
  world.run(5s);
  ASSERT_TRUE(world.has_session(0));
  world.ownership(0).on_forgotten(FleetWorld::robot_name(0));
  world.roam(0, 1);
  world.run(2s);
  EXPECT_EQ(world.actors(0), std::vector<int>{1});
  EXPECT_TRUE(world.has_session(0));
}

/// More robots than a gateway can know, in the name of one that lives.
class FullFleet : public ForgottenRobots {
 protected:
  void SetUp() override {
    ForgottenRobots::SetUp();
    beat_of_gw_1(9000);
    for (std::size_t i = ownership.claims().size(); i < ClaimTable::max_rows; ++i)
      ownership.on_fleet_message({"gw-1", 0x20001, ClaimRobot{fmt::format("r{}", i), 1, {}}},
                                 at(now));
    pass(10ms);
    notices.clear();
  }
  using ForgottenRobots::take;
  void drain() {
    while (auto action = ownership.next_action()) {
      if (const auto* notice = std::get_if<Notice>(&*action)) notices.push_back(notice->text);
      const auto* publish = std::get_if<PublishNow>(&*action);
      const auto read = publish ? decode("gw-0", publish->message.payload) : std::nullopt;
      if (read && std::holds_alternative<AskTable>(read->body)) ++questions;
    }
  }
  std::vector<std::string> notices;
  int questions = 0;
};

TEST_F(FullFleet, IsToldOnceForEachBurstAndCounted) {
  for (int i = 0; i < 100; ++i) ownership.on_heard(fmt::format("new-{}", i), at(now));
  drain();
  ASSERT_EQ(notices.size(), 1U);
  EXPECT_NE(notices[0].find("200000 robots are known"), std::string::npos) << notices[0];
  EXPECT_GE(counted("fleet_claims_not_kept"), 100U);
}

/// The answer has no room, but it takes away what gw-1 does not claim.
TEST_F(FullFleet, AsksOnceAMinuteForWhatItCannotKeep) {
  const auto ask_for = [&](Duration span) {
    questions = 0;
    for (const Duration end = now + span; now < end; now += 500ms) beat_of_gw_1(9000);
    drain();
    return questions;
  };
  ask_for(5s);
  EXPECT_EQ(ask_for(50s), 0) << "its digest is another one all the time";
  EXPECT_EQ(ask_for(20s), 1);
}

}  // namespace
}  // namespace slamgw::fleet::test
