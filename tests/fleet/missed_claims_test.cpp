// SPDX-License-Identifier: Apache-2.0
// A gateway that was cut off has missed a robot's new owner and claims the robot as nobody's, while
// that owner does not hear it: others tell it whose the robot is.
#include "tests/fleet/looped_back.hpp"

namespace slamgw::fleet::test {
namespace {

/// gw-1 has robot "x" with epoch 4. gw-2 is there as well.
class MissedClaims : public LoopedBack {
 protected:
  static constexpr Life life_of_others = 0x20001;

  void SetUp() override {
    LoopedBack::SetUp();
    beat_of("gw-2");
  }
  void gw_1_has_it() {
    beat_of("gw-1");
    comes("gw-1", ClaimRobot{"x", 4, {}});
  }
  void beat_of(const std::string& gateway) {
    const auto sent_ms = std::chrono::duration_cast<std::chrono::milliseconds>(now).count();
    comes(gateway, Beat{sent_ms, 60'000, 0, 0, 9000, 9000});
  }
  void comes(const std::string& gateway, const Body& body) {
    ownership.on_fleet_message({gateway, life_of_others, body}, at(now));
    pass(20ms);
  }
  const Claim of_gw_1{4, "gw-1", life_of_others};
};

TEST_F(MissedClaims, WitnessNamesTheOwner) {
  gw_1_has_it();
  comes("gw-2", ClaimRobot{"x", 1, {}});
  ASSERT_EQ(releases.size(), 1U);
  EXPECT_EQ(releases[0].robot, "x");
  EXPECT_EQ(releases[0].to, of_gw_1);
  EXPECT_TRUE(releases[0].session.empty());
}

TEST_F(MissedClaims, WitnessSaysNothingToWhoeverAsksAnOwnerOrClaimsMore) {
  gw_1_has_it();
  comes("gw-2", ClaimRobot{"x", 3, "gw-7"});
  comes("gw-2", ClaimRobot{"other", 1, {}});
  comes("gw-1", ClaimRobot{"x", 4, {}});
  comes("gw-2", ClaimRobot{"x", 5, {}});
  EXPECT_TRUE(releases.empty());
}

TEST_F(MissedClaims, WitnessLeavesItToTheFirstTwoByName) {
  beat_of("a");
  beat_of("b");
  gw_1_has_it();
  comes("gw-2", ClaimRobot{"x", 1, {}});
  EXPECT_TRUE(releases.empty());
}

TEST_F(MissedClaims, ClaimantThatIsToldAsksTheOwner) {
  beat_of("gw-1");
  claims.clear();
  ownership.on_heard("x", at(now));
  pass(20ms);
  ASSERT_EQ(claims.size(), 1U);
  EXPECT_EQ(claims[0].from, "");
  comes("gw-2", Release{"x", of_gw_1, {}});
  pass(500ms);
  EXPECT_FALSE(ownership.may_act_for("x", at(now).mono));
  ASSERT_EQ(claims.size(), 2U);
  EXPECT_EQ(claims[1].epoch, 5U);
  EXPECT_EQ(claims[1].from, "gw-1");
  comes("gw-1", Release{"x", {5, "gw-0", ownership.life()}, {}});
  EXPECT_TRUE(ownership.may_act_for("x", at(now).mono));
}

}  // namespace
}  // namespace slamgw::fleet::test
