// SPDX-License-Identifier: Apache-2.0
// One session from discovery to loss, as Nordic's client behaves.
#include <gtest/gtest.h>

#include "tests/mqttsn_udp/sn_rig.hpp"

namespace slamgw::mqttsn {
namespace {

TEST(SnGateway, ServesARobotFromDiscoveryToLoss) {
  SnRig rig;
  rig.send(1, SearchGw{1});
  EXPECT_EQ(rig.last_to(1), "GWINFO gw=1 address=");
  rig.send(1, Connect{true, true, 1, 60, "NRF_5"});
  EXPECT_EQ(rig.last_to(1), "WILLTOPICREQ");
  rig.send(1, WillTopic{WireQos::zero, false, "ntnu-slam/robot/NRF_5/gone"});
  EXPECT_EQ(rig.last_to(1), "WILLMSGREQ");
  rig.send(1, WillMsg{to_bytes("bye")});
  EXPECT_EQ(rig.last_to(1), "CONNACK code=0");
  EXPECT_EQ(rig.presence.at(0).presence, Presence::online);
  EXPECT_EQ(rig.presence.at(0).address, "[fd00::1]:47193");

  const auto adv = rig.register_topic(1, "ntnu-slam/robot/NRF_5/adv");
  const auto cmd = rig.register_topic(1, "ntnu-slam/server/NRF_5/cmd");
  Subscribe subscribe;
  subscribe.qos = WireQos::one;
  subscribe.msg_id = 3;
  subscribe.topic_name = "ntnu-slam/server/NRF_5/cmd";
  rig.send(1, subscribe);
  EXPECT_EQ(rig.last_to(1), "SUBACK qos=1 id=" + std::to_string(cmd) + " msg=3 code=0");

  rig.publish(1, adv, 1, 4, "hello");
  EXPECT_TRUE(rig.is_silent(1));
  ASSERT_EQ(rig.reports.size(), 1U);
  EXPECT_EQ(rig.reports[0].topic, "ntnu-slam/robot/NRF_5/adv");
  rig.receipt(rig.reports[0].receipt.id);
  EXPECT_EQ(rig.last_to(1), "PUBACK id=1 msg=4 code=0");

  rig.broker("ntnu-slam/server/NRF_5/cmd", "go", 1);
  EXPECT_EQ(rig.last_to(1), "PUBLISH dup=0 qos=1 retain=0 normal id=2 msg=1 data=676f");
  rig.send(1, Puback{cmd, 1, ReturnCode::accepted});
  ASSERT_EQ(rig.outcomes.size(), 1U);
  EXPECT_EQ(rig.outcomes[0].result, CommandResult::delivered);

  rig.pass_s(89);
  EXPECT_EQ(rig.reports.size(), 1U);
  rig.pass_s(2);
  ASSERT_EQ(rig.reports.size(), 2U);
  EXPECT_TRUE(rig.reports[1].is_will);
  EXPECT_EQ(rig.presence.back().presence, Presence::offline);
  EXPECT_TRUE(rig.is_silent(1));
}

}  // namespace
}  // namespace slamgw::mqttsn
