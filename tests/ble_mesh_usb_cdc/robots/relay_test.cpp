// SPDX-License-Identifier: Apache-2.0
// `ble_mesh.relay`: updates of robots of other meshes reach the group, up to a rate.
#include <gtest/gtest.h>

#include <fmt/format.h>

#include "adapters/ble_mesh_usb_cdc/robots/relay.hpp"
#include "tests/ble_mesh_usb_cdc/mesh_rig.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;

constexpr std::uint16_t relay_group = 0xc100;
constexpr std::string_view near = "0a 00 ec ff";                       // one segment
constexpr std::string_view with_obstacle = "0a 00 ec ff 64 00 2c 01";  // two
constexpr std::string_view most = "01 00 02 00 03 00 04 00 05 00 06 00 07 00 08 00 09 00 0a 00 0b";

Settings relaying() {
  Settings settings;
  settings.relay = {"robot/+/update"};
  return settings;
}

/// Returns a SENSOR_UPDATE_RELAYED as hex without spaces.
std::string relayed(std::string_view robot, std::string_view update) {
  const std::uint16_t number = relayed_number_of(robot);
  return fmt::format("d45900{:02x}{:02x}{}", number & 0xff, number >> 8, to_hex(hex(update)));
}

class Relaying : public ::testing::Test {
 protected:
  explicit Relaying(NodeDatabase database = test_database())
      : rig(relaying(), std::move(database)) {
    rig.start();
    rig.board.sent.clear();
  }

  void say(const std::string& robot, const Bytes& payload, bool retain = false) {
    const std::string topic = "ntnu-slam/robot/" + robot + "/update";
    rig.mesh.on_robot_message({topic, payload, Qos::at_most_once, retain}, rig.now);
    rig.run_for(0ms);
  }
  void say(const std::string& robot, std::string_view update) { say(robot, hex(update)); }
  std::vector<std::string> heard() const { return rig.sent_to(relay_group); }

  MeshRig rig;
};

TEST(RelayedNumber, IsCrc16CcittFalse) {
  EXPECT_EQ(relayed_number_of("123456789"), 0x29b1) << "the check value of CRC-16/CCITT-FALSE";
  EXPECT_EQ(relayed_number_of(""), 0xffff);
  EXPECT_EQ(relayed_number_of("lego-1"), 0x890d);
  EXPECT_EQ(relayed_number_of("robot-4"), relayed_number_of("robot-159"))
      << "docs/topics.md says so";
}

TEST_F(Relaying, SendsUpdateUnchangedToGroup) {
  say("lego-1", near);
  rig.run_for(100ms);
  EXPECT_EQ(heard(), (std::vector<std::string>{"d459000d890a00ecff"}));
  EXPECT_EQ(rig.board.sent.back().source, 0x0001);
  EXPECT_EQ(rig.counter("relayed"), 1u);
  rig.run_for(2600ms);
  say("lego-1", most);
  rig.run_for(100ms);
  EXPECT_EQ(heard().back(), relayed("lego-1", most)) << "its stray octet too";
}

TEST_F(Relaying, IsTracedWhileTracingIsOn) {
  say("lego-1", near);
  rig.run_for(1s);
  EXPECT_TRUE(rig.all<MessageStep>().empty());
  rig.mesh.on_trace(true);
  say("lego-1", near);
  rig.run_for(1s);
  const auto steps = rig.all<MessageStep>();
  ASSERT_EQ(steps.size(), 1u);
  EXPECT_EQ(steps[0].kind, StepKind::sent);
  EXPECT_EQ(steps[0].robot, "lego-1");
  EXPECT_EQ(steps[0].address, "0xc100");
  EXPECT_EQ(steps[0].topic, "ntnu-slam/robot/lego-1/update");
}

TEST_F(Relaying, DoesNotRelayRobotsOfThisMesh) {
  say("nr1", near);  // named in the configuration, and not heard yet
  rig.hear(first_robot + 7, "cb 59 00 0a 00 ec ff");
  say("ble-0107", near);
  rig.run_for(10s);
  EXPECT_TRUE(heard().empty());
  EXPECT_EQ(rig.counter("relays_dropped"), 0u);
}

TEST(RelayingToNodes, DoesNotRelayAbsentNode) {
  NodeDatabase database = test_database();
  Node node;
  node.uuid.fill(1);
  node.address = 0x0120;
  node.state = NodeState::provisioned;
  node.name = "away";
  database.nodes.push_back(node);
  MeshRig rig(relaying(), database);
  rig.start();
  rig.mesh.on_robot_message({"ntnu-slam/robot/away/update", hex(near)}, rig.now);
  rig.run_for(1s);
  EXPECT_TRUE(rig.sent_to(relay_group).empty());
}

TEST(RelayingToNodes, GuestGatewayDoesNotRelay) {
  NodeDatabase database = test_database();
  database.guest_address = 0x0001;
  MeshRig rig(relaying(), database);
  rig.start();
  rig.mesh.on_robot_message({"ntnu-slam/robot/lego-1/update", hex(near)}, rig.now);
  rig.run_for(1s);
  EXPECT_TRUE(rig.sent_to(relay_group).empty());
}

TEST(RelayingToNodes, DoesNotRelayBannedRobot) {
  MeshRig rig(relaying(), test_database(), RobotNames({}, Bans({"lego-1"})));
  rig.start();
  rig.mesh.on_robot_message({"ntnu-slam/robot/lego-1/update", hex(near)}, rig.now);
  rig.run_for(1s);
  EXPECT_TRUE(rig.sent_to(relay_group).empty());
}

TEST_F(Relaying, IgnoresRetainedUpdates) {
  say("lego-1", hex(near), true);
  rig.run_for(1s);
  EXPECT_TRUE(heard().empty());
}

TEST_F(Relaying, RelaysTenUpdatesASecondAndTheLatestOfEachSenderInTurn) {
  for (int second = 0; second < 2; ++second) {
    for (int i = 0; i < 10; ++i) {
      for (const char* robot : {"a", "b", "c", "d"}) say(robot, near);
      rig.run_for(100ms);
    }
  }
  EXPECT_LE(heard().size(), 21u);
  EXPECT_GE(heard().size(), 19u);
  for (const char* robot : {"a", "b", "c", "d"})
    EXPECT_NEAR(static_cast<double>(std::ranges::count(heard(), relayed(robot, near))), 5.0, 1.0)
        << robot;
  EXPECT_EQ(rig.counter("relayed") + rig.counter("relays_superseded") + 3, 80u) << "three wait";
}

TEST_F(Relaying, QueuesOnlyNewestUpdateOfSender) {
  say("a", "01 00 01 00");
  say("a", "02 00 02 00");
  say("a", "03 00 03 00");
  rig.run_for(1s);
  EXPECT_EQ(heard(),
            (std::vector<std::string>{relayed("a", "01 00 01 00"), relayed("a", "03 00 03 00")}));
  EXPECT_EQ(rig.counter("relays_superseded"), 1u);
}

TEST_F(Relaying, SendsOneSegmentedUpdateAtATimeWithoutDelayingOthers) {
  say("a", with_obstacle);
  say("b", most);
  for (int i = 0; i < 25; ++i) {
    say("c", near);
    rig.run_for(100ms);
  }
  EXPECT_EQ(std::ranges::count(heard(), relayed("a", with_obstacle)), 1);
  EXPECT_EQ(std::ranges::count(heard(), relayed("b", most)), 0) << "the first is still on the air";
  EXPECT_GE(std::ranges::count(heard(), relayed("c", near)), 23);
  rig.run_for(200ms);
  EXPECT_EQ(std::ranges::count(heard(), relayed("b", most)), 1);
}

/// A sender whose updates come in one segment and in two in turns keeps its place.
TEST_F(Relaying, SendersTakeTurnsWithSegmentedUpdates) {
  for (int i = 0; i < 300; ++i) {
    for (const char* robot : {"a", "b", "c"}) say(robot, most);
    rig.run_for(100ms);
  }
  ASSERT_EQ(heard().size(), 12u) << "30 s";
  for (const char* robot : {"a", "b", "c"})
    EXPECT_EQ(std::ranges::count(heard(), relayed(robot, most)), 4) << robot;
}

TEST_F(Relaying, QueuesUpdatesOfUpToMaxSendersAndCountsRest) {
  for (int i = 0; i < 200; ++i) say(fmt::format("robot-{:03}", i), near);
  EXPECT_EQ(rig.counter("relays_dropped"), 200 - Relay::max_senders - 1) << "one is out";
  rig.run_for(20s);
  EXPECT_EQ(heard().size(), Relay::max_senders + 1);
  EXPECT_FALSE(rig.mesh.deadline() && *rig.mesh.deadline() <= rig.now);
}

TEST_F(Relaying, DropsAndCountsInvalidMessages) {
  say("a", Bytes{});
  say("a", Bytes(400, 'x'));
  say("a", Bytes(3, 'x'));
  say("a", Bytes(6, 'x'));
  say("a", Bytes(22, 'x'));
  say(std::string(200, 'i'), near);
  say("", near);
  say("a/b", near);
  say("a\x01", near);
  rig.mesh.on_robot_message({"ntnu-slam/robot/a/adv", hex(near)}, rig.now);
  rig.mesh.on_robot_message({"", {}}, rig.now);
  rig.run_for(10s);
  EXPECT_TRUE(heard().empty());
  EXPECT_EQ(rig.counter("relays_dropped"), 11u);
  say(std::string(64, 'i'), near);
  EXPECT_EQ(rig.counter("relayed"), 1u);
}

TEST_F(Relaying, SendsAcknowledgementsAndCommandsFirst) {
  rig.latency = 20ms;
  for (std::uint16_t i = 0; i < 6; ++i)
    rig.hear(static_cast<std::uint16_t>(first_robot + i), "ca 59 00");  // each wants a STATUS
  rig.command("nr1/cmd", hex("01 00 02 00"));
  say("lego-1", near);
  EXPECT_EQ(rig.counter("relayed"), 0u) << "other messages wait for the board";
  rig.run_for(80ms);
  EXPECT_TRUE(heard().empty());
  rig.run_for(2s);
  ASSERT_EQ(heard().size(), 1u);
  std::vector<std::uint16_t> destinations;
  for (const auto& packet : rig.board.sent) destinations.push_back(packet.destination);
  const auto relay = std::ranges::find(destinations, relay_group);
  EXPECT_GE(std::count(destinations.begin(), relay, first_robot), 2) << "STATUS and command";
  EXPECT_GE(relay - destinations.begin(), 7);
}

TEST_F(Relaying, DropsUpdatesWhileLinkIsDown) {
  for (const char* robot : {"a", "b", "c"}) say(robot, near);
  rig.run_for(50ms);
  rig.mesh.on_port_closed("unplugged", rig.now);
  rig.run_for(10ms);
  EXPECT_EQ(rig.counter("relays_dropped"), 2u);
  say("d", near);
  EXPECT_EQ(rig.counter("relays_dropped"), 3u);
  rig.open();
  rig.run_for(5s);
  EXPECT_EQ(heard().size(), 1u);
  say("e", near);
  rig.run_for(1s);
  EXPECT_EQ(heard().size(), 2u);
}

/// Robots never send this opcode.
TEST_F(Relaying, CountsRelayedUpdateFromRobotAsUnknownOpcode) {
  rig.hear(first_robot, "d4 59 00 0d 89 0a 00 ec ff");
  EXPECT_TRUE(rig.all<Report>().empty());
  EXPECT_EQ(rig.counter("unknown_opcodes"), 1u);
}

}  // namespace
}  // namespace slamgw::ble
