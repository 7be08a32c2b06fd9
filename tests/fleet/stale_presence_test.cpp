// SPDX-License-Identifier: Apache-2.0
// What a dead gateway has announced is withdrawn by a member that knows of it, when the next owner
// does not.
#include "tests/fleet/fleet_world.hpp"
#include "tests/fleet/looped_back.hpp"

namespace slamgw::fleet::test {
namespace {

/// gw-0 is cut off, gw-1 takes its robot over and dies, and gw-0 is back.
TEST(StalePresence, OfAGatewayThatTheNextOwnerNeverHeardOfIsWithdrawn) {
  FleetWorld world({.gateways = 3, .robots = 1});
  world.run(5s);
  world.cut_link(0);
  world.run(3s);
  world.roam(0, 1);
  world.run(3s);
  ASSERT_EQ(world.actors(0), std::vector<int>{1});
  world.kill(1);
  world.roam(0, 0);
  world.run(3s);
  world.restore_link(0);
  world.run(8s);
  EXPECT_EQ(world.actors(0), std::vector<int>{0});
  EXPECT_EQ(world.judge().strange_presence, 0) << world.describe();
}

/// gw-0 is cut off; the robot comes to gw-1, which waits for gw-0, and goes on to gw-2.
TEST(StalePresence, OfAGatewayThatDiesWhileItsRobotIsPassedOnIsWithdrawn) {
  FleetWorld world({.gateways = 3, .robots = 1, .lost = 0});
  world.run(5s);
  world.cut_link(0);
  world.roam(0, 1);
  world.run(300ms);
  world.roam(0, 2);
  world.run(1500ms);  // gw-0 believes that the robot is there still
  EXPECT_EQ(world.actors(0), std::vector<int>{2});
  EXPECT_EQ(world.judge().strange_presence, 0) << world.describe();
}

/// gw-0 is cut off; the robot comes to gw-1, which is cut off before it has it, and goes on to
/// gw-2.
TEST(StalePresence, OfTwoGatewaysThatDieOneAfterTheOtherIsWithdrawn) {
  FleetWorld world({.gateways = 3, .robots = 1, .lost = 0});
  world.run(5s);
  world.cut_link(0);
  world.roam(0, 1);
  world.run(100ms);
  world.cut_link(1);
  world.roam(0, 2);
  world.run(1800ms);  // gw-0 believes that the robot is there still
  EXPECT_EQ(world.actors(0), std::vector<int>{2});
  EXPECT_EQ(world.judge().strange_presence, 0) << world.describe();
}

/// gw-1 has had robot "x" with epoch 5, and is dead.
class WitnessOfADeadOwner : public LoopedBack {
 protected:
  void SetUp() override {
    LoopedBack::SetUp();
    beat_of("gw-1", 500);
    claim_of("gw-1", 5);
    pass(3s);
    beat_of("gw-2", 60'000);
    withdrawn.clear();
  }
  void beat_of(const std::string& gateway, std::uint32_t period_ms) {
    const auto sent_ms = std::chrono::duration_cast<std::chrono::milliseconds>(now).count();
    ownership.on_fleet_message({gateway, 0x20001, Beat{sent_ms, period_ms, 0, 0, 9000, 9000}},
                               at(now));
  }
  void claim_of(const std::string& gateway, std::uint64_t epoch) {
    ownership.on_fleet_message({gateway, 0x20001, ClaimRobot{"x", epoch, {}}}, at(now));
    pass(20ms);
  }
  const std::vector<std::string> entry{"p/gateway/gw-1/robots/x"};
};

TEST_F(WitnessOfADeadOwner, WithdrawsItsEntryWhenTheClaimIsNotGreater) {
  claim_of("gw-2", 5);
  EXPECT_EQ(withdrawn, entry);
  claim_of("gw-2", 5);
  EXPECT_EQ(withdrawn, entry) << "once";
}

TEST_F(WitnessOfADeadOwner, ReadsTablesAsWell) {
  ownership.on_fleet_message({"gw-2", 0x20001, Table{{}, {}, {{"x", 1}}}}, at(now));
  pass(20ms);
  EXPECT_EQ(withdrawn, entry);
}

TEST_F(WitnessOfADeadOwner, LeavesItToAClaimantThatKnows) {
  claim_of("gw-2", 6);
  EXPECT_TRUE(withdrawn.empty());
}

TEST_F(WitnessOfADeadOwner, LeavesTheEntryOfAGatewayThatIsBack) {
  ownership.on_fleet_message({"gw-1", 0x20002, Beat{1, 60'000, 0, 0, 9000, 9000}}, at(now));
  claim_of("gw-2", 1);
  EXPECT_TRUE(withdrawn.empty());
  EXPECT_EQ(ownership.place_of("x", at(now).mono)->gateway, "gw-2");
}

TEST_F(WitnessOfADeadOwner, LeavesItToTheFirstTwoByName) {
  beat_of("a", 60'000);
  beat_of("b", 60'000);
  claim_of("a", 1);  // that leaves one before this gateway
  EXPECT_EQ(withdrawn, entry);
}

TEST_F(WitnessOfADeadOwner, IsTheThirdByName) {
  beat_of("a", 60'000);
  beat_of("b", 60'000);
  claim_of("gw-2", 1);
  EXPECT_TRUE(withdrawn.empty());
}

}  // namespace
}  // namespace slamgw::fleet::test
