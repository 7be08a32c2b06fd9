// SPDX-License-Identifier: Apache-2.0
// The settings differ from those of the last start: robots get the new ones, unless another tool
// configured them.
#include <gtest/gtest.h>

#include "adapters/ble_mesh_usb_cdc/provisioning/mesh_json.hpp"
#include "tests/ble_mesh_usb_cdc/provisioning_rig.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;
using Groups = std::set<std::uint16_t>;

/// The daemon's next start, with the board and the robots as the last one left them.
struct NextRig : ProvisioningRig {
  NextRig(const ProvisioningRig& last, Settings settings)
      : ProvisioningRig(std::move(settings), last.on_disk()) {
    board = last.board;
    for (FakeDevice& each : board.devices.devices) each.requests.clear();
  }

  bool is_configured_within(Duration limit) {
    for (const TimePoint end = now + limit; now < end;) {
      if (is_configured()) return true;
      pass(500ms);
    }
    return false;
  }
  bool is_configured() const {
    return std::ranges::none_of(on_disk().nodes,
                                [](const Node& node) { return node.applied->is_changing; }) &&
           has_notice("is reconfigured");
  }
  std::size_t requests() const {
    std::size_t sum = 0;
    for (const FakeDevice& each : board.devices.devices) sum += each.requests.size();
    return sum;
  }
  FakeDevice& device() { return board.devices.devices[0]; }
  nlohmann::json row() {
    order(NodesOrder{});
    return answer()[0];
  }
};

class Reconfiguration : public ::testing::Test {
 protected:
  Reconfiguration() {
    first.add(1);
    first.start();
    if (!first.all_configured(20s)) ADD_FAILURE() << "the robot did not join";
    other_groups.groups = {0xc002, 0xc005};
    other_ttl.ttl = 8;
  }

  Settings other_groups;
  Settings other_ttl;
  ProvisioningRig first;
};

TEST_F(Reconfiguration, SendsNothingWhenSettingsAreUnchanged) {
  NextRig next(first, {});
  next.start();
  next.pass(60s);
  EXPECT_EQ(next.requests(), 0u);
  EXPECT_EQ(next.board.count(0x9c), first.board.count(0x9c)) << "no device key was loaded";
  EXPECT_TRUE(next.stored.empty());
}

TEST_F(Reconfiguration, IgnoresOrderOfGroups) {
  Settings settings;
  std::ranges::reverse(settings.groups);
  NextRig next(first, settings);
  next.start();
  next.pass(60s);
  EXPECT_EQ(next.requests(), 0u);
}

TEST_F(Reconfiguration, SendsChangedGroups) {
  NextRig next(first, other_groups);
  next.start();
  ASSERT_TRUE(next.is_configured_within(5s));
  EXPECT_TRUE(next.has_notice("ble-0100 is reconfigured: its groups are 0xc002, 0xc005"));
  for (const auto& [model, groups] : next.device().subscriptions)
    EXPECT_EQ(groups, (Groups{0xc002, 0xc005})) << model;
  for (const NodeDatabase& database : next.stored)
    EXPECT_EQ(database.nodes[0].state, NodeState::configured);
  EXPECT_EQ(next.on_disk().nodes[0].applied->groups, other_groups.groups);
  EXPECT_TRUE(next.board.devices.device_keys.empty());
  NextRig third(next, other_groups);
  third.start();
  third.pass(60s);
  EXPECT_EQ(third.requests(), 0u);
}

TEST_F(Reconfiguration, RemovesAllGroups) {
  Settings none;
  none.groups.clear();
  NextRig next(first, none);
  next.start();
  ASSERT_TRUE(next.is_configured_within(5s));
  EXPECT_TRUE(next.has_notice("ble-0100 is reconfigured: it has no groups"));
  for (const auto& [model, groups] : next.device().subscriptions) EXPECT_EQ(groups, Groups{});
}

TEST_F(Reconfiguration, SendsChangedTtlAndCountsHopsFromIt) {
  NextRig next(first, other_ttl);
  next.answers_stores = false;  // robots get nothing before the disk has it
  next.start();
  next.pass(2s);
  EXPECT_EQ(next.requests(), 0u);
  next.hear(0x0100, "cb 59 00 01 00 02 00");
  EXPECT_EQ(next.all<Report>().back().radio->hops, std::nullopt)
      << "the robot may get the new TTL at this moment";
  next.answers_stores = true;
  next.mesh.on_stored({}, next.now);
  ASSERT_TRUE(next.is_configured_within(5s));
  EXPECT_TRUE(next.has_notice("ble-0100 is reconfigured: its TTL is 8"));
  EXPECT_EQ(std::ranges::count(next.device().requests, "0300010100000008000059000600"), 1);
  EXPECT_EQ(next.on_disk().nodes[0].ttl, 8);
  next.hear(0x0100, "cb 59 00 01 00 02 00");
  EXPECT_EQ(next.all<Report>().back().radio->hops, 4);
}

TEST_F(Reconfiguration, SendsChangedAddressOfGateway) {
  Settings settings;
  settings.address = 0x0002;
  NextRig next(first, settings);
  next.start();
  EXPECT_FALSE(next.is_up()) << "the board has the old address";
  next.order(ResetBoardOrder{});
  ASSERT_TRUE(next.is_configured_within(5s));
  EXPECT_TRUE(next.has_notice("ble-0100 is reconfigured: it publishes to 0x0002"));
  EXPECT_EQ(std::ranges::count(next.device().requests, "0300010200000004000059000600"), 1);
  EXPECT_EQ(next.on_disk().nodes[0].applied->destination, 0x0002);
}

TEST_F(Reconfiguration, SendsGroupOfGateways) {
  Settings settings;
  settings.gateway_group = 0xc010;
  NextRig next(first, settings);
  next.start();
  ASSERT_TRUE(next.is_configured_within(5s));
  EXPECT_TRUE(next.has_notice("ble-0100 is reconfigured: it publishes to 0xc010"));
  EXPECT_EQ(std::ranges::count(next.device().requests, "03000110c0000004000059000600"), 1);
  EXPECT_EQ(next.on_disk().nodes[0].applied->destination, 0xc010);
  const auto again = decode_node_database(encode_node_database(next.on_disk()));
  ASSERT_TRUE(again.has_value());
  EXPECT_EQ(again->nodes[0].applied->destination, 0xc010);
}

TEST_F(Reconfiguration, SubscribesToTheRelaysGroupAndLeavesIt) {
  Settings relaying;
  relaying.relay = {"robot/+/update"};
  NextRig next(first, relaying);
  next.start();
  ASSERT_TRUE(next.is_configured_within(5s));
  EXPECT_TRUE(next.has_notice("ble-0100 is reconfigured: it hears relayed updates in 0xc100"));
  const std::string client = "000159000600";  // sensor_update's
  const std::string server = "000159000900";  // pos_cmd's
  EXPECT_EQ(next.device().subscriptions[client], (Groups{0xc100}));
  EXPECT_EQ(next.device().subscriptions[server], (Groups{0xc002, 0xc003, 0xc004}));
  const auto again = decode_node_database(encode_node_database(next.on_disk()));
  ASSERT_TRUE(again.has_value());
  EXPECT_EQ(again->nodes[0].applied->relay_group, 0xc100);

  NextRig same(next, relaying);
  same.start();
  same.pass(60s);
  EXPECT_EQ(same.requests(), 0u);

  relaying.relay_group = 0xc101;
  NextRig other(same, relaying);
  other.start();
  ASSERT_TRUE(other.is_configured_within(5s));
  EXPECT_EQ(other.device().subscriptions[client], (Groups{0xc101}));

  NextRig last(other, {});
  last.start();
  ASSERT_TRUE(last.is_configured_within(5s));
  EXPECT_TRUE(last.has_notice("ble-0100 is reconfigured: it hears no relayed updates"));
  EXPECT_EQ(last.device().subscriptions[client], Groups{});
  EXPECT_FALSE(last.on_disk().nodes[0].applied->relay_group);
}

/// A robot whose sensor_update client cannot subscribe keeps its configuration.
TEST_F(Reconfiguration, ReportsRobotThatCannotReceiveRelayedUpdates) {
  Settings relaying;
  relaying.relay = {"robot/+/update"};
  NextRig next(first, relaying);
  next.device().refuses["802b000159000600"] = 0x08;
  next.device().refuses["801b000100c159000600"] = 0x08;
  next.start();
  next.pass(5s);
  EXPECT_TRUE(
      next.has_notice("still has its old configuration: the list of subscriptions of model "
                      "0x0059:0x0006 was refused"))
      << next.all<Notice>().back().text;
  next.hear(0x0100, "cb 59 00 01 00 02 00");
  EXPECT_EQ(next.all<Report>().size(), 1u);
}

TEST_F(Reconfiguration, ReportsAllChanges) {
  Settings settings = other_groups;
  settings.ttl = 8;
  NextRig next(first, settings);
  next.start();
  ASSERT_TRUE(next.is_configured_within(5s));
  EXPECT_TRUE(next.has_notice(": its TTL is 8; its groups are 0xc002, 0xc005"));
}

TEST_F(Reconfiguration, LetsMessagesAndCommandsPass) {
  NextRig next(first, other_groups);
  next.board.devices.devices[0].deaf_to = {"8029"};
  next.start();
  next.pass(2s);
  ASSERT_GT(next.requests(), 0u);
  next.hear(0x0100, "cb 59 00 01 00 02 00");
  EXPECT_EQ(next.all<Report>().size(), 1u);
  next.command("ble-0100/cmd", hex("01 00 02 00"));
  EXPECT_EQ(next.sent_to(0x0100).back(), "cd590001000200");
  EXPECT_EQ(next.row()["state"], "configured");
}

TEST_F(Reconfiguration, IgnoresNodesThatItDidNotConfigure) {
  NodeDatabase database = first.on_disk();
  database.nodes[0].applied.reset();  // as in files of older versions and imports
  Settings settings = other_groups;
  settings.ttl = 8;
  ProvisioningRig next(settings, database);
  next.board = first.board;
  next.board.devices.devices[0].requests.clear();
  next.start();
  next.pass(60s);
  EXPECT_TRUE(next.board.devices.devices[0].requests.empty());
  EXPECT_TRUE(next.stored.empty());
  next.hear(0x0100, "cb 59 00 01 00 02 00");
  EXPECT_EQ(next.all<Report>().back().radio->hops, 0) << "it still sends with the old TTL";
}

TEST_F(Reconfiguration, ReconfiguresRobotsOfImportedMesh) {
  ProvisioningRig next(other_ttl, std::nullopt);
  next.board = first.board;
  next.start();
  next.order(ImportOrder{encode_node_database(first.on_disk())});
  next.pass(5s);
  EXPECT_EQ(next.answer()["nodes"], 1) << next.answer();
  EXPECT_TRUE(next.has_notice("ble-0100 is reconfigured: its TTL is 8"));
}

TEST_F(Reconfiguration, WaitsForARobotThatIsOutOfReach) {
  NextRig next(first, other_groups);
  next.device().deaf_to = {"80"};
  next.start();
  next.pass(22s);
  EXPECT_TRUE(
      next.has_notice("ble-0100 still has its old configuration: no answer to the composition data "
                      "in 20 s; the next attempt is in 5 s"));
  EXPECT_FALSE(next.has_notice("not configured"));
  EXPECT_EQ(next.row()["state"], "configured");
  EXPECT_EQ(next.row()["problem"], "no answer to the composition data in 20 s");
  next.pass(120s);  // the next attempt is late
  next.device().deaf_to.clear();
  next.hear(0x0100, "04 00 59 00");
  EXPECT_TRUE(next.is_configured_within(3s));
  EXPECT_EQ(next.row()["problem"], "");
}

TEST_F(Reconfiguration, ReportsRefusedRequest) {
  NextRig next(first, other_groups);
  next.device().refuses = {{"801b000105c0", 0x05}};
  next.start();
  next.pass(4s);
  EXPECT_TRUE(
      next.has_notice("ble-0100 still has its old configuration: the subscription to 0xc005 of "
                      "model 0x1000 was refused: insufficient resources (0x05)"));
  EXPECT_FALSE(next.has_notice("is reconfigured"));
  next.device().refuses.clear();
  EXPECT_TRUE(next.is_configured_within(10s));
}

TEST_F(Reconfiguration, UndoesInterruptedChangeWhenSettingsAreRestored) {
  NextRig next(first, other_groups);
  next.device().deaf_to = {"801b"};
  next.start();
  next.pass(3s);
  ASSERT_EQ(next.device().subscriptions.at("00010010"), Groups{0xc002});
  NextRig third(next, {});
  third.device().deaf_to.clear();
  third.start();
  ASSERT_TRUE(third.is_configured_within(5s));
  EXPECT_TRUE(third.has_notice("ble-0100 is reconfigured: all its settings were sent again"));
  EXPECT_EQ(third.device().subscriptions.at("00010010"), (Groups{0xc002, 0xc003, 0xc004}));
}

TEST_F(Reconfiguration, AppliesLastSettingsWheneverDaemonIsKilled) {
  for (Duration life{}; life < 1s; life += 20ms) {
    NextRig next(first, other_groups);
    next.mesh.on_start();
    next.open();
    next.run_for(life);
    NextRig third(next, {});
    third.start();
    third.pass(5s);
    for (const auto& [model, groups] : third.device().subscriptions)
      ASSERT_EQ(groups, (Groups{0xc002, 0xc003, 0xc004})) << model << " after " << life / 1ms;
    ASSERT_FALSE(third.on_disk().nodes[0].applied->is_changing);
  }
}

TEST_F(Reconfiguration, ProvisionsRobotThatWasResetByHand) {
  NextRig next(first, other_groups);
  next.device().address = 0;
  next.start();
  next.pass(40s);
  EXPECT_EQ(next.device().address, 0x0101);
  EXPECT_EQ(next.device().subscriptions.at("01010010"), (Groups{0xc002, 0xc005}));
  EXPECT_EQ(next.on_disk().nodes[0].applied->groups, other_groups.groups);
  EXPECT_TRUE(next.has_notice("ble-0100 is configured"));
  EXPECT_FALSE(next.has_notice("is reconfigured"));
}

TEST(ReconfigurationOfMany, IsNotDelayedByRobotsThatAreSwitchedOff) {
  ProvisioningRig first;
  for (std::uint8_t number = 1; number <= 20; ++number) first.add(number);
  first.start();
  ASSERT_TRUE(first.all_configured(60s));
  Settings settings;
  settings.ttl = 8;
  NextRig next(first, settings);
  for (FakeDevice& device : next.board.devices.devices) device.deaf_to = {"80"};
  next.board.devices.at(0x0113)->deaf_to.clear();
  next.start();
  next.hear(0x0113, "04 00 59 00");
  next.pass(25s);
  EXPECT_TRUE(next.has_notice("ble-0113 is reconfigured"));
  next.add(21);
  next.pass(25s);
  EXPECT_TRUE(next.has_notice("ble-0114 is configured"));
  EXPECT_LE(next.board.devices.most_device_keys, NodeConversations::max_conversations);
  for (FakeDevice& device : next.board.devices.devices) device.deaf_to.clear();
  for (std::uint16_t address = 0x0100; address < 0x0113; ++address)
    next.hear(address, "04 00 59 00");
  EXPECT_TRUE(next.is_configured_within(60s));
}

}  // namespace
}  // namespace slamgw::ble
