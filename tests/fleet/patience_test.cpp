// SPDX-License-Identifier: Apache-2.0
// How long a gateway that claims a robot waits for a living owner that does not answer.
#include "tests/fleet/looped_back.hpp"

namespace slamgw::fleet::test {
namespace {

/// gw-1 owns robot "x" and hears nothing of what this gateway says.
class SilentOwner : public LoopedBack {
 protected:
  void own_with_beats_each(std::chrono::milliseconds span) {
    period = span;
    beat();
    ownership.on_fleet_message({"gw-1", 0x20001, ClaimRobot{"x", 5, {}}}, at(now));
    pass(1s);
    claims.clear();
    claims_qos.clear();
    ownership.on_heard("x", at(now));
  }
  void beat() {
    const auto sent_ms = std::chrono::duration_cast<std::chrono::milliseconds>(now).count();
    ownership.on_fleet_message(
        {"gw-1", 0x20001,
         Beat{sent_ms, static_cast<std::uint32_t>(period.count()), 0, 0, 9000, 9000}},
        at(now));
  }
  void wait_for(Duration span) {
    for (const Duration end = now + span; now < end;) {
      beat();
      pass(std::min<Duration>(end - now, period));
    }
  }
  bool is_served() { return ownership.may_act_for("x", at(now).mono); }
  std::chrono::milliseconds period{};
};

TEST_F(SilentOwner, IsPassedOverAfterFiveSeconds) {
  own_with_beats_each(500ms);
  wait_for(4900ms);
  EXPECT_FALSE(is_served());
  wait_for(200ms);
  EXPECT_TRUE(is_served());
}

/// With a thousand gateways a beat comes every 5 s, and the lease is 12 s.
TEST_F(SilentOwner, IsNotPassedOverWhileItsLeaseMayHold) {
  own_with_beats_each(5s);
  wait_for(14900ms);
  EXPECT_FALSE(is_served());
  wait_for(200ms);
  EXPECT_TRUE(is_served());
}

TEST_F(SilentOwner, CannotMakeOthersWaitForEverWithAForgedPeriod) {
  own_with_beats_each(60s);
  pass(29900ms);
  EXPECT_FALSE(is_served());
  pass(200ms);
  EXPECT_TRUE(is_served());
}

/// A broker that holds back messages with QoS 1 for one of its clients delivers its beats.
TEST_F(SilentOwner, IsToldOfTheClaimInBothWays) {
  own_with_beats_each(500ms);
  wait_for(4500ms);
  EXPECT_EQ(claims_qos, (std::vector<Qos>{Qos::at_least_once, Qos::at_most_once, Qos::at_least_once,
                                          Qos::at_most_once, Qos::at_least_once}));
  for (const ClaimRobot& claim : claims) EXPECT_EQ(claim.epoch, 6U);
}

/// The robot goes on from here to gw-2 before gw-1 has made way for this gateway.
class PassesOn : public SilentOwner {
 protected:
  void SetUp() override {
    SilentOwner::SetUp();
    own_with_beats_each(500ms);
    wait_for(100ms);
    ownership.on_fleet_message({"gw-2", 0x30001, Beat{1, 60'000, 0, 0, 9000, 9000}}, at(now));
    claim_of_gw_2();
    ownership.on_given_up("x", next, {}, at(now));
    wait_for(100ms);
  }
  void claim_of_gw_2() {
    ownership.on_fleet_message({"gw-2", next.life, ClaimRobot{"x", next.epoch, "gw-0"}}, at(now));
  }
  const Claim next{7, "gw-2", 0x30001};
};

/// It is repeated each second, and a broker may double it.
TEST_F(PassesOn, MakesNoWayBeforeTheFormerOwnerWhenTheClaimComesAgain) {
  claim_of_gw_2();
  wait_for(1s);
  EXPECT_TRUE(releases.empty());
  ownership.on_fleet_message({"gw-1", 0x20001, Release{"x", {6, "gw-0", ownership.life()}, {}}},
                             at(now));
  pass(20ms);
  ASSERT_EQ(releases.size(), 1U);
  EXPECT_EQ(releases[0].to, next);
  claim_of_gw_2();
  pass(20ms);
  EXPECT_EQ(releases.size(), 2U) << "the first may be lost";
}

TEST_F(PassesOn, WaitsForAnOwnerThatLivesAsLongAsAClaimDoes) {
  wait_for(4500ms);
  EXPECT_TRUE(releases.empty());
  wait_for(1s);
  EXPECT_EQ(releases.size(), 1U);
}

TEST_F(PassesOn, AsksTheFormerOwnerAgain) {
  claims.clear();
  wait_for(2s);
  ASSERT_EQ(claims.size(), 2U);
  EXPECT_EQ(claims[0].epoch, 6U);
  EXPECT_EQ(claims[0].from, "gw-1");
  // It has heard the claim of gw-2 by now, and says so.
  ownership.on_fleet_message({"gw-1", 0x20001, Release{"x", next, {}}}, at(now));
  wait_for(2s);
  EXPECT_EQ(claims.size(), 2U);
  ASSERT_EQ(releases.size(), 1U);
  EXPECT_EQ(releases[0].to, next);
}

TEST_F(PassesOn, DoesNotWaitForAnOwnerThatHasDied) {
  pass(1600ms);
  EXPECT_EQ(releases.size(), 1U);
}

/// Its mesh has 30 s since it came; the outcome says how long ago that was.
TEST_F(LoopedBack, TellsTheMeshForHowLongACommandHasWaited) {
  command(now);
  pass(100ms);
  EXPECT_LE(waited, 20ms);
  const std::uint64_t key = said.at(0).key;
  said.clear();
  lost = 3;
  command(now);
  pass(6s);
  ASSERT_EQ(carried, 2);
  EXPECT_GE(waited, 3s);
  EXPECT_LE(waited, 3100ms);
  ownership.on_own_outcome(
      {"p/gateway/gw-0/commands/r", to_bytes(R"({"type":"cmd"})"), Qos::at_least_once, false}, 6s,
      at(now));
  pass(10ms);
  EXPECT_EQ(told, 1);
  said.clear();
  comes_from_gw_1(Taken{1, key, "r", "cmd", 6000, true});
  pass(10ms);
  ASSERT_EQ(said.size(), 1U);
  EXPECT_TRUE(said[0].is_ended) << "it knows that the outcome was of this command";
}

/// Its beats do not come back for so long that it begins anew.
TEST_F(LoopedBack, TellsAtOnceTheOutcomeOfWhatItHasCarriedOutInThisLife) {
  const Life before = ownership.life();
  is_writing_lost = true;
  pass(1500ms);
  command(now);
  pass(500ms);
  is_writing_lost = false;
  for (int i = 0; i < 50 && carried == 0; ++i) {
    ownership.on_heard("r", at(now));
    pass(100ms);
  }
  ASSERT_EQ(carried, 1);
  ASSERT_NE(ownership.life(), before);
  EXPECT_GE(waited, 1s) << "it came in the life before";
  ownership.on_own_outcome(
      {"p/gateway/gw-0/commands/r", to_bytes(R"({"type":"cmd"})"), Qos::at_least_once, false},
      waited + 100ms, at(now));
  pass(10ms);
  EXPECT_EQ(told, 1);
}

}  // namespace
}  // namespace slamgw::fleet::test
