// SPDX-License-Identifier: Apache-2.0
// Questions about robots that have fallen silent, and their answers, of gateways that have just
// begun a life: nobody has heard their first beat.
#include "tests/fleet/looped_back.hpp"
#include "tests/fleet/will_of.hpp"

namespace slamgw::fleet::test {
namespace {

constexpr Life former_life = 0x20001;
constexpr Life new_life = 0x20002;

class PendingWill : public LoopedBack {
 protected:
  void SetUp() override {
    LoopedBack::SetUp();
    beat_of_gw_1(60'000);
    pass(16s);  // gw-1 no longer counts as a newcomer
    ASSERT_TRUE(ownership.may_act_for("r", at(now).mono));
  }
  void will_is_due() {
    ownership.on_will(will_of("r"), at(now));
    pass(1s);
  }
  void comes_from(const std::string& gateway, Life life, const Body& body) {
    ownership.on_fleet_message({gateway, life, body}, at(now));
  }
};

TEST_F(PendingWill, IsNotPublishedWhenAGatewayHasHeardTheRobotThatNobodyHasHeardYet) {
  will_is_due();
  comes_from("gw-2", new_life, Heard{"r"});
  pass(20s);
  EXPECT_EQ(wills, 0);
}

TEST_F(PendingWill, IsNotPublishedWhenAGatewayInANewLifeHasHeardTheRobot) {
  will_is_due();
  comes_from("gw-1", new_life, Heard{"r"});
  pass(20s);
  EXPECT_EQ(wills, 0);
}

/// The broker may deliver it half a minute late.
TEST_F(PendingWill, IsPublishedInSpiteOfAnAnswerOfAFormerLife) {
  comes_from("gw-1", new_life, Beat{1, 60'000, 0, 0, 60'000, 60'000});
  will_is_due();
  comes_from("gw-1", former_life, Heard{"r"});
  pass(20s);
  EXPECT_EQ(wills, 1);
}

TEST_F(PendingWill, OfAGatewayThatNobodyHasHeardYetIsAnswered) {
  ownership.on_heard("r", at(now));
  pass(100ms);
  comes_from("gw-2", new_life, AskForSign{"r", 2000});
  comes_from("gw-1", new_life, AskForSign{"r", 2000});
  comes_from("gw-2", new_life, AskForSign{"r", 50});
  comes_from("gw-2", new_life, AskForSign{"unknown", 2000});
  pass(10ms);
  EXPECT_EQ(answered, (std::vector<std::string>{"p/fleet/to/gw-2/gw-0", "p/fleet/to/gw-1/gw-0"}));
}

}  // namespace
}  // namespace slamgw::fleet::test
