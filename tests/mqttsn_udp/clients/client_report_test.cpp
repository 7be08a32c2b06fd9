// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/clients/client_table.hpp"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

using namespace std::chrono_literals;

TEST(ClientReport, HasARowForEachClientSortedByRobot) {
  SnRig rig;
  EXPECT_TRUE(rig.gateway.report({}, rig.now).empty());
  rig.connect(2, "tank", false);
  rig.connect(1, "crane", true);
  rig.pass(3s);
  const auto rows = rig.gateway.report({}, rig.now);
  ASSERT_EQ(rows.size(), 2U);
  EXPECT_EQ(rows[0]["robot"], "crane");
  EXPECT_EQ(rows[0]["clean_session"], true);
  EXPECT_EQ(rows[1]["robot"], "tank");
  EXPECT_EQ(rows[1]["state"], "active");
  EXPECT_EQ(rows[1]["heard_ms_ago"], 3000);
  EXPECT_EQ(rows[1]["topics"], 0);
  EXPECT_FALSE(rows[1].contains("sleep_s"));
}

TEST(ClientReport, ListsTheTopicsOfOneSession) {
  SnRig rig;
  rig.connect(1, "tank", false);
  rig.send(1, Register{0, 1, "ntnu-slam/robot/tank/adv"});
  rig.sleep(1, 300);
  const auto rows = rig.gateway.report("tank", rig.now);
  ASSERT_EQ(rows.size(), 1U);
  EXPECT_EQ(rows[0]["state"], "asleep");
  EXPECT_EQ(rows[0]["sleep_s"], 300);
  ASSERT_EQ(rows[0]["topics"].size(), 1U);
  EXPECT_EQ(rows[0]["topics"][0]["name"], "ntnu-slam/robot/tank/adv");
  EXPECT_EQ(rows[0]["topics"][0]["told"], true);
  EXPECT_TRUE(rows[0]["subscriptions"].empty());
  EXPECT_TRUE(rig.gateway.report("nobody", rig.now).empty());
}

}  // namespace
}  // namespace slamgw::mqttsn
