// SPDX-License-Identifier: Apache-2.0
// Two clients that connect in turns with the same client id.
#include <gtest/gtest.h>

#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

/// Connects two clients in turns, so that they take the session from each other.
void contest(SnRig& rig, int times) {
  for (int i = 0; i < times; ++i) {
    rig.connect(1 + static_cast<unsigned>(i % 2), "r1", true);
    rig.pass_s(5);
  }
}

TEST(Contested, ReportsAClientIdThatTwoAddressesUseInTurns) {
  SnRig rig;
  contest(rig, 3);
  for (const PresenceChange& change : rig.presence) EXPECT_FALSE(change.is_contested);
  EXPECT_TRUE(rig.notices.empty());
  contest(rig, 4);
  EXPECT_TRUE(rig.presence.back().is_contested);
  ASSERT_EQ(rig.notices.size(), 1U) << "one notice for all takeovers";
  EXPECT_EQ(rig.notices[0].severity, Severity::warning);
  EXPECT_EQ(rig.notices[0].robot, "r1");
  for (const unsigned n : {1U, 2U}) {
    const std::string address = to_string(Peer{SnRig::address(n), {}});
    EXPECT_NE(rig.notices[0].text.find(address), std::string::npos) << rig.notices[0].text;
  }
}

TEST(Contested, EndsWhenOneAddressIsSilentForAMinute) {
  SnRig rig;
  contest(rig, 5);
  ASSERT_TRUE(rig.presence.back().is_contested);
  for (int i = 0; i < 6; ++i) {
    EXPECT_TRUE(rig.presence.back().is_contested);
    rig.pass_s(10);
    rig.send(1, Pingreq{});
  }
  EXPECT_FALSE(rig.presence.back().is_contested);
  EXPECT_EQ(rig.presence.back().presence, Presence::online);
}

TEST(Contested, IgnoresARobotThatMovesOrRestarts) {
  SnRig rig;
  for (unsigned n = 1; n <= 10; ++n) {  // a new address each time
    rig.connect(n, "r1", true);
    rig.pass_s(31);
  }
  for (unsigned n = 1; n <= 10; ++n) {
    rig.connect(n, "r1", false);
    rig.send(n, Disconnect{});
  }
  for (int i = 0; i < 10; ++i) rig.connect(1, "r1", true);
  for (const PresenceChange& change : rig.presence) EXPECT_FALSE(change.is_contested);
  EXPECT_TRUE(rig.notices.empty());
}

}  // namespace
}  // namespace slamgw::mqttsn
