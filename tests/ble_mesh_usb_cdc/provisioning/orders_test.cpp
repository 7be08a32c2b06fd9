// SPDX-License-Identifier: Apache-2.0
// Orders of operators: scan, provision, nodes, remove, ping, config, import, reset-board.
#include <gtest/gtest.h>

#include "adapters/ble_mesh_usb_cdc/provisioning/mesh_json.hpp"
#include "tests/ble_mesh_usb_cdc/provisioning_rig.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;

constexpr const char* uuid_1 = "736c616d010101010101010101010101";

Settings by_hand() {
  Settings settings;
  settings.provisioning.enabled = false;
  return settings;
}

std::string text_of(const nlohmann::json& answer) {
  return answer.is_string() ? answer.get<std::string>() : answer.dump();
}

struct JoinedRig : ProvisioningRig {
  explicit JoinedRig(Settings settings = {}) : ProvisioningRig(std::move(settings)) {
    add(1);
    start();
    if (!all_configured(20s)) ADD_FAILURE() << "the robot did not join";
  }
  FakeDevice& device() { return board.devices.devices[0]; }
};

TEST(Orders, ScanListsDevicesInReach) {
  ProvisioningRig rig(by_hand());
  rig.add(1);
  rig.start();
  rig.order(ScanOrder{});
  rig.pass(9s);
  EXPECT_TRUE(rig.answer().is_null());
  rig.pass(2s);
  ASSERT_EQ(rig.answer().size(), 1u) << rig.answer();
  EXPECT_EQ(rig.answer()[0]["uuid"], uuid_1);
  EXPECT_EQ(rig.answer()[0]["rssi_dbm"], -56);
  EXPECT_EQ(rig.answer()[0]["state"], "new");
  EXPECT_FALSE(rig.board.devices.is_scanning) << "the scan has ended";
}

TEST(Orders, ProvisionNamesTheRobot) {
  ProvisioningRig rig(by_hand());
  rig.add(1);
  rig.start();
  rig.order(ProvisionOrder{uuid_1, "lego-1"});
  rig.pass(5s);
  EXPECT_EQ(rig.answer()["robot"], "lego-1") << rig.answer();
  EXPECT_EQ(rig.answer()["state"], "configured");
  rig.hear(0x0100, "cb 59 00 01 00 02 00");
  EXPECT_EQ(rig.all<Report>().back().topic, "ntnu-slam/robot/lego-1/update");
  rig.command("lego-1/cmd", hex("01 00 02 00"));
  EXPECT_EQ(rig.sent_to(0x0100).back(), "cd590001000200");
  // After a restart, too.
  ProvisioningRig next(by_hand(), rig.stored.back());
  next.board = rig.board;
  next.start();
  next.hear(0x0100, "cb 59 00 01 00 02 00");
  EXPECT_EQ(next.all<Report>().back().robot, "lego-1");
}

TEST(Orders, ProvisionTakesTheConfiguredAddressOfAName) {
  ProvisioningRig rig(by_hand(), test_database(),
                      RobotNames({{"nr1", 0x0100, {}}, {"nr7", 0x0700, {}}}));
  rig.add(1);
  rig.add(2);
  rig.start();
  rig.order(ProvisionOrder{uuid_1, "nr7"});
  rig.pass(5s);
  EXPECT_EQ(rig.answer()["address"], "0x0700");
  rig.order(ProvisionOrder{"736c616d-0202-0202-0202-020202020202", "other"});
  rig.pass(5s);
  EXPECT_EQ(rig.answer()["address"], "0x0101") << "0x0100 has the name nr1: " << rig.answer();
  EXPECT_EQ(rig.answer()["robot"], "other");
}

TEST(Orders, ProvisionRefusesTheNameOfADeviceOnThread) {
  const RobotNames names({{"r1", {}, "client-1", {}}});
  ProvisioningRig rig(by_hand(), test_database(), names);
  rig.add(1);
  rig.start();
  rig.order(ProvisionOrder{uuid_1, "r1"});
  EXPECT_NE(text_of(rig.answer()).find("on Thread"), std::string::npos) << rig.answer();
}

TEST(Orders, ProvisionReportsInvalidOrders) {
  JoinedRig rig;
  const auto answer_to = [&](std::string uuid, std::string robot) {
    rig.order(ProvisionOrder{std::move(uuid), std::move(robot)});
    return text_of(rig.answer());
  };
  EXPECT_NE(answer_to("12", "r").find("32 hex digits"), std::string::npos);
  EXPECT_NE(answer_to(uuid_1, "a/b").find("1 to 64 bytes"), std::string::npos);
  EXPECT_NE(answer_to(uuid_1,
                      "a\xe2\x80\xae"
                      "b")
                .find("invisible"),
            std::string::npos)
      << "U+202E reverses the text after it";
  EXPECT_NE(answer_to(uuid_1, "r").find("in the mesh already, as ble-0100"), std::string::npos);
  EXPECT_NE(answer_to(std::string(32, 'a'), "ble-0100").find("is another robot"),
            std::string::npos);
  EXPECT_EQ(answer_to(std::string(32, 'a'), "r"), "null") << "the scan for the device is running";
  rig.order(ScanOrder{});
  EXPECT_NE(rig.answers.back().error.find("still under way"), std::string::npos);
  rig.pass(31s);
  EXPECT_NE(rig.answers.back().error.find("was not heard"), std::string::npos);
}

TEST(Orders, ProvisionReportsFailureAndUnconfiguredRobot) {
  ProvisioningRig rig(by_hand());
  rig.add(1).deaf_to = {"80"};
  rig.board.devices.closes_at = 0xc7;
  rig.start();
  rig.order(ProvisionOrder{uuid_1, "r"});
  rig.pass(5s);
  EXPECT_EQ(rig.answer(), "the provisioning link ended: failed");
  rig.order(ProvisionOrder{uuid_1, "r"});
  rig.pass(40s);
  EXPECT_EQ(rig.answer()["state"], "provisioned") << rig.answer();
  EXPECT_EQ(rig.answer()["problem"], "no answer to the composition data in 20 s");
}

TEST(Orders, NodesAreListed) {
  JoinedRig rig;
  rig.order(NodesOrder{});
  ASSERT_EQ(rig.answer().size(), 1u);
  EXPECT_EQ(rig.answer()[0]["robot"], "ble-0100");
  EXPECT_EQ(rig.answer()[0]["state"], "configured");
  ProvisioningRig without({}, std::nullopt);
  without.order(NodesOrder{});
  EXPECT_EQ(without.answer(), nlohmann::json::array());
}

TEST(Orders, PingReportsCopiesHopsAndSignal) {
  JoinedRig rig;
  const std::size_t stored = rig.stored.size();
  rig.order(PingOrder{"ble-0100"});
  rig.pass(2s);
  EXPECT_EQ(rig.answer()["answered"], true) << rig.answer();
  EXPECT_EQ(rig.answer()["mesh"], "ble");
  EXPECT_EQ(rig.answer()["copies"], 1);
  EXPECT_EQ(rig.answer()["hops"].get<int>(), 4 - rig.answer()["ttl"].get<int>());
  EXPECT_TRUE(rig.answer().contains("rssi_dbm"));
  EXPECT_EQ(rig.stored.size(), stored) << "nothing has changed";
  EXPECT_TRUE(rig.board.devices.device_keys.empty());
}

TEST(Orders, PingsWaitInLine) {
  JoinedRig rig;
  rig.order(ScanOrder{});
  for (int i = 0; i < 3; ++i) rig.order(PingOrder{"ble-0100"});
  EXPECT_TRUE(rig.answers.empty());
  rig.order(ScanOrder{});
  ASSERT_EQ(rig.answers.size(), 1U);
  EXPECT_NE(rig.answers[0].error.find("still under way"), std::string::npos);
  rig.pass(15s);
  ASSERT_EQ(rig.answers.size(), 5U) << "the scan and the pings";
  EXPECT_EQ(rig.answer()["answered"], true) << rig.answer();
}

TEST(Orders, PingsInLineAreBounded) {
  JoinedRig rig;
  rig.order(ScanOrder{});
  for (int i = 0; i < 17; ++i) rig.order(PingOrder{"ble-0100"});
  ASSERT_EQ(rig.answers.size(), 1U);
  EXPECT_NE(rig.answers[0].error.find("still under way"), std::string::npos);
  rig.board.devices.devices[0].deaf_to = {"80"};
  rig.pass(200s);
  EXPECT_EQ(rig.answers.size(), 18U) << "each has an answer";
}

TEST(Orders, PingOfASilentRobotEndsSoon) {
  JoinedRig rig;
  rig.device().deaf_to = {"800c"};
  rig.order(PingOrder{"ble-0100"});
  rig.pass(6s);
  EXPECT_EQ(rig.answer()["answered"], false) << rig.answer();
  EXPECT_EQ(rig.answer()["why"], "no answer to its default TTL in 5 s");
  rig.order(PingOrder{"nobody"});
  EXPECT_NE(text_of(rig.answer()).find("no robot of this mesh is called nobody"),
            std::string::npos);
}

TEST(Orders, ConfigShowsSettingsOfNode) {
  JoinedRig rig;
  const auto before = rig.device().requests.size();
  rig.order(NodeConfigOrder{"ble-0100"});
  rig.pass(10s);
  const auto answer = rig.answer();
  EXPECT_EQ(answer["ttl"], 4) << answer;
  EXPECT_EQ(answer["relay"]["state"], "on");
  EXPECT_EQ(answer["relay"]["sends"], 3);
  EXPECT_EQ(answer["relay"]["interval_ms"], 20);
  EXPECT_EQ(answer["transmit"]["sends"], 1);
  EXPECT_EQ(answer["wanted"], nlohmann::json::object());
  const auto model = [&](const char* name) {
    for (const auto& row : answer["models"])
      if (row["name"] == name) return row;
    return nlohmann::json();
  };
  EXPECT_EQ(model("sensor_update client")["publishes_to"], "0x0001");
  EXPECT_EQ(model("sensor_update client")["publish_ttl"], 4);
  EXPECT_TRUE(model("pos_cmd server").contains("subscribed_to")) << answer;
  for (auto i = before; i < rig.device().requests.size(); ++i)
    EXPECT_FALSE(rig.device().requests[i].starts_with("03")) << "nothing is changed";
}

TEST(Orders, ConfigStoresSettingsAndSendsThemToNode) {
  JoinedRig rig;
  NodeConfigOrder order{"ble-0100"};
  order.ttl.emplace(7);
  order.relay.emplace(false);
  order.transmit.emplace(Transmissions{3, 20});
  rig.order(order);
  rig.pass(20s);
  EXPECT_EQ(rig.device().default_ttl, hex("07")) << rig.answer();
  EXPECT_EQ(rig.device().relay[0], 0);
  EXPECT_EQ(rig.device().network_transmit, hex("0a"));
  EXPECT_EQ(rig.answer()["ttl"], 7);
  EXPECT_EQ(rig.answer()["relay"]["state"], "off");
  EXPECT_EQ(rig.answer()["wanted"]["transmit"]["interval_ms"], 20);
  const auto stored = decode_node_database(encode_node_database(rig.stored.back()));
  ASSERT_TRUE(stored.has_value());
  EXPECT_EQ(stored->nodes[0].wishes, rig.stored.back().nodes[0].wishes);
  EXPECT_EQ(stored->nodes[0].wishes.ttl, 7);
  EXPECT_EQ(stored->nodes[0].ttl, 7) << "it publishes with it, too";
  NodeConfigOrder back{"ble-0100"};
  back.ttl.emplace(std::nullopt);
  rig.order(back);
  rig.pass(20s);
  EXPECT_EQ(rig.stored.back().nodes[0].ttl, 4) << rig.answer();
  EXPECT_EQ(rig.stored.back().nodes[0].wishes.relay, false);
}

TEST(Orders, ConfigDuringAConfigurationIsSentAfterIt) {
  JoinedRig rig;
  NodeConfigOrder order{"ble-0100"};
  order.ttl.emplace(7);
  order.relay.emplace(false);
  rig.device().deaf_to = {"03"};  // until the attempt fails
  rig.order(order);
  for (int i = 0; i < 60 && rig.answer().is_null(); ++i) rig.pass(1s);
  ASSERT_NE(text_of(rig.answer()).find("tried again"), std::string::npos);
  for (int i = 0; i < 60 && rig.board.devices.device_keys.empty(); ++i) rig.pass(500ms);
  rig.pass(1s);
  order.ttl.emplace(3);
  order.relay.emplace(true);
  rig.order(order);
  rig.device().deaf_to.clear();
  rig.pass(60s);
  EXPECT_EQ(rig.device().default_ttl, hex("03"));
  EXPECT_EQ(rig.device().relay[0], 1);
  EXPECT_EQ(rig.on_disk().nodes.at(0).ttl, 3);
  EXPECT_FALSE(rig.on_disk().nodes.at(0).applied->is_changing);
  EXPECT_EQ(rig.answer()["ttl"], 3) << rig.answer();
}

TEST(Orders, ConfigGivesARobotGroupsOfItsOwn) {
  JoinedRig rig;
  const auto hears = [&](std::uint16_t group) {
    return std::ranges::any_of(rig.device().subscriptions,
                               [&](const auto& list) { return list.second.contains(group); });
  };
  NodeConfigOrder order{"ble-0100"};
  order.subscribe = 0xc0aa;
  rig.order(order);
  rig.pass(20s);
  EXPECT_TRUE(hears(0xc0aa)) << rig.answer();
  EXPECT_EQ(rig.answer()["wanted"]["subscribed_to"], nlohmann::json::array({"0xc0aa"}));
  const auto stored = decode_node_database(encode_node_database(rig.stored.back()));
  ASSERT_TRUE(stored.has_value());
  EXPECT_EQ(stored->nodes[0].wishes.groups, (std::vector<std::uint16_t>{0xc0aa}));
  rig.pass(60s);
  EXPECT_TRUE(hears(0xc0aa)) << "its own groups are kept";
  order.subscribe.reset();
  order.unsubscribe = 0xc0aa;
  rig.order(order);
  rig.pass(20s);
  EXPECT_FALSE(hears(0xc0aa)) << rig.answer();
  order.unsubscribe = Settings{}.groups.at(0);
  rig.order(order);
  EXPECT_NE(text_of(rig.answer()).find("ble_mesh.groups"), std::string::npos) << rig.answer();
  order.unsubscribe.reset();
  for (std::uint16_t group = 0xd000; group <= 0xd000 + NodeWishes::max_groups; ++group) {
    order.subscribe = group;
    rig.order(order);
    rig.pass(20s);
  }
  EXPECT_NE(text_of(rig.answer()).find("may have 8 groups"), std::string::npos) << rig.answer();
}

TEST(Orders, ConfigChangesDestinationOfOneModel) {
  JoinedRig rig;
  const auto last_destination = [&](const char* model) {
    std::string destination;
    for (const std::string& request : rig.device().requests)
      if (request.starts_with("03") && request.ends_with(model)) destination = request.substr(6, 4);
    return destination;
  };
  NodeConfigOrder order{"ble-0100"};
  order.publish = {"sensor_update", 0xc00a};
  rig.order(order);
  rig.pass(20s);
  EXPECT_EQ(last_destination("59000600"), "0ac0") << rig.answer();
  EXPECT_EQ(last_destination("59000400"), "0100") << "the other models keep theirs";
  EXPECT_EQ(rig.answer()["wanted"]["publishes_to"]["0x0059:0x0006"], "0xc00a");
  EXPECT_NE(rig.answer()["warnings"].dump().find("does not hear 0xc00a"), std::string::npos);
  const auto stored = decode_node_database(encode_node_database(rig.stored.back()));
  ASSERT_TRUE(stored.has_value());
  EXPECT_EQ(stored->nodes[0].wishes, rig.stored.back().nodes[0].wishes);
  EXPECT_EQ(stored->nodes[0].wishes.publications.at("0x0059:0x0006"), 0xc00a);

  rig.order(ResetBoardOrder{});
  rig.pass(20s);
  EXPECT_EQ(last_destination("59000400"), "0200") << "the board's next life";
  EXPECT_EQ(last_destination("59000600"), "0ac0");

  order.publish = {"0x0059:0x0006", Settings{}.groups.at(0)};
  rig.order(order);
  rig.pass(20s);
  EXPECT_FALSE(rig.answer().contains("warnings")) << rig.answer();
  order.publish = {"sensor_update client", std::nullopt};
  rig.order(order);
  rig.pass(20s);
  EXPECT_EQ(last_destination("59000600"), "0200") << rig.answer();
  EXPECT_TRUE(rig.stored.back().nodes[0].wishes.publications.empty());
}

TEST(Orders, ConfigTakesTheGatewaysOwnAddressForTheDefault) {
  JoinedRig rig;
  NodeConfigOrder order{"ble-0100"};
  order.publish = {"sensor_update", 0x0001};
  rig.order(order);
  rig.pass(20s);
  EXPECT_FALSE(rig.answer()["wanted"].contains("publishes_to")) << rig.answer();
  EXPECT_TRUE(rig.has_notice("ble-0100 is reconfigured: all its settings were sent again"));
  rig.order(ResetBoardOrder{});
  rig.pass(20s);
  const auto& requests = rig.device().requests;
  EXPECT_EQ(std::ranges::count(requests, "0300010200000004000059000600"), 1)
      << "it follows the gateway to its next address";
}

TEST(Orders, ConfigRejectsModelsThatDoNotPublish) {
  JoinedRig rig;
  NodeConfigOrder order{"ble-0100"};
  for (const char* const model : {"Generic OnOff", "0x0059:0x0009", "sensor", ""}) {
    order.publish = {model, 0xc00a};
    rig.order(order);
    EXPECT_NE(text_of(rig.answer()).find("is not a model that publishes"), std::string::npos);
  }
  order.publish = {"pos_cmd", 0xc00a};
  rig.order(order);
  rig.pass(20s);
  EXPECT_NE(rig.answer()["warnings"].dump().find("has no model 0x0059:0x0008"), std::string::npos);
}

TEST(Orders, ConfigReportsSettingsThatNodeRefuses) {
  JoinedRig rig;
  rig.device().relay = hex("02 00");
  NodeConfigOrder order{"ble-0100"};
  order.relay.emplace(true);
  rig.order(order);
  rig.pass(20s);
  EXPECT_NE(text_of(rig.answer()).find("relaying was not changed"), std::string::npos)
      << rig.answer();
  rig.device().deaf_to = {"80"};
  rig.order(NodeConfigOrder{"ble-0100"});
  rig.pass(60s);
  EXPECT_NE(text_of(rig.answer()).find("no answer to"), std::string::npos) << rig.answer();
}

TEST(Orders, ConfigRefusesNodeOfAnotherTool) {
  JoinedRig joined;
  NodeDatabase database = joined.stored.back();
  database.nodes[0].applied.reset();
  ProvisioningRig rig({}, database);
  rig.board = joined.board;
  rig.start();
  NodeConfigOrder order{"ble-0100"};
  order.ttl.emplace(7);
  rig.order(order);
  rig.pass(1s);
  EXPECT_NE(text_of(rig.answer()).find("by another tool"), std::string::npos) << rig.answer();
}

TEST(Orders, RemoveResetsRobotAndDoesNotProvisionItAgain) {
  JoinedRig rig;
  rig.hear(0x0100, "cb 59 00 01 00 02 00");
  rig.order(RemoveOrder{"ble-0100"});
  rig.pass(2s);
  EXPECT_EQ(rig.answer()["robot"], "ble-0100") << rig.answer();
  EXPECT_EQ(rig.device().address, 0);
  EXPECT_TRUE(rig.stored.back().nodes.empty());
  EXPECT_TRUE(rig.board.devices.device_keys.empty());
  EXPECT_EQ(rig.all<PresenceChange>().back().presence, Presence::offline);
  EXPECT_EQ(rig.all<UnsubscribeRequest>().back().filter, "ntnu-slam/server/ble-0100/+");
  rig.pass(60s);
  EXPECT_EQ(rig.device().address, 0);
  rig.order(ProvisionOrder{uuid_1, "again"});
  rig.pass(10s);
  EXPECT_EQ(rig.answer()["address"], "0x0101") << rig.answer();
}

/// A robot resets itself after its answer, so it can't answer again.
TEST(Orders, RemoveSucceedsThoughTheRobotsAnswerIsLost) {
  for (const bool is_open : {true, false}) {
    JoinedRig joined;
    ProvisioningRig rig(is_open ? Settings{} : by_hand(), joined.on_disk());
    rig.board = joined.board;
    rig.start();
    rig.spoil = [](Bytes& transfer) {
      constexpr std::size_t message_frame = 23;
      if (to_hex(transfer).ends_with("804a")) transfer.resize(transfer.size() - message_frame);
    };
    rig.order(RemoveOrder{"ble-0100"});
    rig.pass(10s);
    EXPECT_EQ(rig.answer()["robot"], "ble-0100") << rig.answer();
    EXPECT_TRUE(rig.on_disk().nodes.empty());
    rig.pass(30s);
    EXPECT_EQ(rig.board.devices.devices[0].address, 0) << "it does not join again by itself";
  }
}

/// A beacon may be spoofed: a robot that is still heard has not been reset.
TEST(Orders, RemoveDoesNotTakeASpoofedBeaconForTheRobotsAnswer) {
  JoinedRig rig;
  rig.add(1);  // another device with its UUID
  rig.device().deaf_to = {"8049"};
  rig.hear(first_robot, "cb 59 00 01 00 02 00");
  rig.order(RemoveOrder{"ble-0100"});
  for (int second = 0; second < 25; ++second) {
    rig.pass(1s);
    rig.hear(first_robot, "cb 59 00 01 00 02 00");
  }
  EXPECT_NE(text_of(rig.answer()).find("still in the mesh"), std::string::npos) << rig.answer();
  EXPECT_EQ(rig.on_disk().nodes.size(), 1u);
}

/// While the robot is in reach, the beacon may be another device's.
TEST(Orders, RemoveRepeatsResetBeforeBeaconCounts) {
  JoinedRig rig;
  rig.device().deaf_to = {"8049"};
  rig.run_for(10s);
  rig.add(1);  // another device with its UUID
  rig.order(RemoveOrder{"ble-0100"});
  rig.pass(3s);
  EXPECT_EQ(rig.answer(), nullptr) << rig.answer();
  rig.device().deaf_to.clear();
  rig.pass(4s);
  EXPECT_EQ(rig.answer()["was_reset"], true) << rig.answer();
  EXPECT_EQ(rig.device().address, 0) << "the robot itself";
}

TEST(Orders, RemoveEndsWhenTheRemovalIsOnDisk) {
  JoinedRig rig;
  rig.answers_stores = false;
  rig.order(RemoveOrder{"ble-0100"});
  rig.pass(2s);
  ASSERT_TRUE(rig.on_disk().nodes.empty());
  EXPECT_EQ(rig.answer(), nullptr);
  rig.mesh.on_stored({}, rig.now);
  rig.run_for(1ms);
  EXPECT_EQ(rig.answer()["was_reset"], true) << rig.answer();
}

TEST(Orders, RemoveReportsFullDisk) {
  JoinedRig rig;
  rig.store_problem = "the disk is full";
  rig.order(RemoveOrder{"ble-0100"});
  rig.pass(2s);
  EXPECT_NE(text_of(rig.answer()).find("the disk is full"), std::string::npos) << rig.answer();
}

/// The gateway sends nothing to a robot while a change of the mesh waits for the disk.
TEST(Orders, RemoveThatCannotBeginFailsAndDoesNotContinue) {
  for (const bool is_forced : {false, true}) {
    JoinedRig rig;
    rig.answers_stores = false;
    rig.say(hex("05 d3 07 00 00 00"));  // the IV index
    rig.order(RemoveOrder{"ble-0100", is_forced});
    rig.pass(155s);
    EXPECT_NE(text_of(rig.answer()).find("still in the mesh"), std::string::npos) << rig.answer();
    EXPECT_EQ(text_of(rig.answer()).find("continues"), std::string::npos) << rig.answer();
    rig.answers_stores = true;
    rig.mesh.on_stored({}, rig.now);
    rig.pass(30s);
    EXPECT_EQ(rig.on_disk().nodes.size(), 1u);
  }
}

TEST(Orders, ConfigThatCannotBeginFails) {
  JoinedRig rig;
  rig.answers_stores = false;
  rig.say(hex("05 d3 07 00 00 00"));  // the IV index
  rig.order(NodeConfigOrder{"ble-0100"});
  rig.pass(155s);
  EXPECT_NE(text_of(rig.answer()).find("try again"), std::string::npos) << rig.answer();
}

/// One command was sent, others wait: each ends once, by the removal or when the robot joins
/// again.
TEST(Orders, EachCommandToARobotThatLeavesHasOneOutcome) {
  for (const bool is_removed : {true, false}) {
    JoinedRig rig;
    rig.hear(first_robot, "cb 59 00 01 00 02 00");
    for (const char* type : {"a", "b", "cmd", "cmd"})
      rig.command("ble-0100/" + std::string(type), hex("01 00 02 00"));
    rig.run_for(10ms);
    if (is_removed) {
      rig.order(RemoveOrder{"ble-0100"});
    } else {
      rig.device().address = 0;
    }
    rig.pass(28s);
    ASSERT_EQ(rig.device().address, is_removed ? 0 : 0x0101);
    const std::size_t sent = rig.sent_to(first_robot).size();
    rig.hear(first_robot, "c8 59 00 00");
    rig.pass(40s);
    EXPECT_EQ(rig.sent_to(first_robot).size(), sent) << "no more messages to the robot";
    std::vector<std::uint64_t> ended;
    for (const CommandOutcome& outcome : rig.all<CommandOutcome>())
      ended.push_back(static_cast<std::uint64_t>(outcome.id));
    std::ranges::sort(ended);
    EXPECT_EQ(ended, (std::vector<std::uint64_t>{1, 2, 3, 4})) << is_removed;
  }
}

/// A removed robot may have been stolen: it still knows the keys of the mesh.
TEST(Orders, RemoveChangesNoKey) {
  JoinedRig rig;
  rig.add(2);
  rig.pass(30s);
  ASSERT_EQ(rig.configured(), 2u);
  const NodeDatabase before = rig.on_disk();
  rig.order(RemoveOrder{"ble-0100"});
  rig.pass(2s);
  EXPECT_EQ(rig.answer()["robot"], "ble-0100") << rig.answer();
  const NodeDatabase& after = rig.on_disk();
  EXPECT_EQ(after.keys.net_key, before.keys.net_key);
  EXPECT_EQ(after.keys.app_key, before.keys.app_key);
  ASSERT_EQ(after.nodes.size(), 1u);
  EXPECT_EQ(after.nodes[0].device_key, before.nodes[1].device_key);
  EXPECT_EQ(rig.board.subnets.size(), 1u);
}

TEST(Orders, RemoveOfASilentRobotNeedsForce) {
  JoinedRig rig;
  rig.device().deaf_to = {"8049"};
  rig.order(RemoveOrder{"ble-0100"});
  rig.pass(25s);
  EXPECT_NE(text_of(rig.answer()).find("--force"), std::string::npos) << rig.answer();
  EXPECT_EQ(rig.stored.back().nodes.size(), 1u);
  rig.order(RemoveOrder{"ble-0100", true});
  rig.pass(25s);
  EXPECT_EQ(rig.answer()["robot"], "ble-0100") << rig.answer();
  EXPECT_TRUE(rig.stored.back().nodes.empty());
  rig.order(RemoveOrder{"ble-0100"});
  EXPECT_NE(text_of(rig.answer()).find("no robot of this mesh"), std::string::npos);
}

TEST(Orders, ImportStoresMeshAndConfiguresBoardWithItsKeys) {
  NodeDatabase foreign = test_database();
  foreign.keys.net_key.fill(0x77);
  Node node;
  node.uuid.fill(5);
  node.address = 0x0010;
  node.state = NodeState::configured;
  node.name = "old";
  foreign.nodes = {node};
  ProvisioningRig rig({}, std::nullopt);
  rig.board.unicast = 1;
  rig.board.subnets = {{std::uint16_t{0}, Bytes(16, 0x77)}};
  rig.board.appkeys = {{std::uint16_t{0}, Bytes(16, 0x22)}};
  rig.add(1);
  rig.start();
  rig.pass(5s);
  EXPECT_EQ(rig.board.count(0x63), 0u) << "it does not have the mesh's keys";
  rig.order(ImportOrder{encode_node_database(foreign)});
  rig.pass(5s);
  EXPECT_EQ(rig.answer()["nodes"], 1) << rig.answer();
  EXPECT_TRUE(rig.is_up());
  rig.pass(5s);
  EXPECT_EQ(rig.configured(), 2u);
  rig.hear(0x0010, "cb 59 00 01 00 02 00");
  EXPECT_EQ(rig.all<Report>().back().robot, "old");
}

TEST(Orders, ImportAndExportWaitForSlowDisk) {
  ProvisioningRig rig({}, std::nullopt);
  rig.answers_stores = false;
  rig.order(ImportOrder{encode_node_database(test_database())});
  rig.pass(200s);
  EXPECT_EQ(rig.answer(), nullptr) << rig.answer();
  rig.answers_stores = true;
  rig.mesh.on_stored({}, rig.now);
  rig.start();
  EXPECT_EQ(rig.answer()["nodes"], 0) << rig.answer();
  EXPECT_TRUE(rig.is_up());
  EXPECT_EQ(rig.keys_drawn, 0);
  rig.answers_stores = false;
  rig.order(ExportOrder{});
  rig.pass(200s);
  EXPECT_EQ(rig.answer(), nullptr) << rig.answer();
  rig.mesh.on_stored({}, rig.now);
  rig.run_for(1ms);
  EXPECT_EQ(rig.answer()["address"], "0x0021") << rig.answer();
}

TEST(Orders, ImportIsRefusedWhileFirstKeysAreMade) {
  NodeDatabase foreign = test_database();
  foreign.keys.net_key.fill(0x77);
  for (const bool is_disk_full : {false, true}) {
    ProvisioningRig rig({}, std::nullopt);
    rig.answers_stores = false;
    rig.start();
    ASSERT_EQ(rig.keys_drawn, 2);
    rig.order(ImportOrder{encode_node_database(foreign)});
    EXPECT_EQ(rig.answer(), "the mesh's keys are being made; try again");
    rig.answers_stores = true;
    rig.mesh.on_stored(is_disk_full ? "no space" : "", rig.now);
    rig.run_for(1s);
    rig.order(ImportOrder{encode_node_database(foreign)});
    rig.run_for(1s);
    EXPECT_EQ(text_of(rig.answer()).find("another mesh already") == std::string::npos, is_disk_full)
        << rig.answer();
    EXPECT_EQ(rig.on_disk().keys == foreign.keys, is_disk_full);
  }
}

TEST(Orders, ImportEndsThoughBoardAsksForKeys) {
  for (const bool is_disk_full : {false, true}) {
    ProvisioningRig rig({}, std::nullopt);
    rig.answers_stores = false;
    rig.order(ImportOrder{encode_node_database(test_database())});
    rig.start();
    rig.answers_stores = true;
    rig.mesh.on_stored(is_disk_full ? "no space" : "", rig.now);
    rig.run_for(2s);
    EXPECT_EQ(rig.answer() == "no space", is_disk_full) << rig.answer();
    EXPECT_EQ(rig.is_up(), !is_disk_full);
    rig.run_for(40s);
    EXPECT_TRUE(rig.is_up());
    EXPECT_EQ(rig.keys_drawn, is_disk_full ? 2 : 0);
  }
}

TEST(Orders, ImportRefusesAnotherMeshAndReportsFullDisk) {
  JoinedRig rig;
  NodeDatabase foreign = test_database();
  foreign.keys.net_key.fill(0x77);
  rig.order(ImportOrder{encode_node_database(foreign)});
  EXPECT_NE(text_of(rig.answer()).find("another mesh already"), std::string::npos);
  EXPECT_EQ(text_of(rig.answer()).find("7777"), std::string::npos);
  rig.order(ImportOrder{"{}"});
  EXPECT_NE(text_of(rig.answer()).find("neither"), std::string::npos);
  rig.store_problem = "no space";
  rig.order(ImportOrder{encode_node_database(test_database())});
  rig.run_for(1s);
  EXPECT_EQ(rig.answer(), "no space");
  rig.order(NodesOrder{});
  EXPECT_EQ(rig.answer().size(), 1u);
}

TEST(Orders, FailedImportKeepsBoardsNewLife) {
  JoinedRig rig;
  rig.board.forgets = true;
  NodeDatabase more = rig.on_disk();
  Node& node = more.nodes.emplace_back();
  node.uuid.fill(5);
  node.address = 0x0300;
  rig.answers_stores = false;
  rig.order(ImportOrder{encode_node_database(more)});
  rig.say(rig.board.restart());
  rig.run_for(1s);
  EXPECT_FALSE(rig.is_up()) << "its next address is not on disk";
  rig.mesh.on_stored("no space", rig.now);
  rig.answers_stores = true;
  rig.run_for(10s);
  EXPECT_EQ(rig.answer(), "no space");
  EXPECT_TRUE(rig.is_up());
  EXPECT_EQ(rig.source_of_an_answer(), 0x0002);
  EXPECT_EQ(rig.on_disk().nodes.size(), 1u);
}

TEST(Orders, ImportWaitsForADeviceThatIsJoining) {
  JoinedRig rig;
  rig.add(2);
  while (rig.board.count(0x63) < 2) {
    rig.say(rig.board.devices.beacons());
    rig.run_for(5ms);
  }
  rig.order(ImportOrder{encode_node_database(test_database())});
  EXPECT_EQ(rig.answer(), "the mesh is being changed right now; try again");
  EXPECT_TRUE(rig.all_configured(30s));
}

TEST(Orders, ResetBoardClearsItAndSetsItUpAgain) {
  JoinedRig rig;
  rig.order(ResetBoardOrder{});
  rig.run_for(2s);
  EXPECT_EQ(rig.answer()["cleared"], true) << rig.answer();
  EXPECT_EQ(rig.board.count(0xac), 1u);
  EXPECT_EQ(rig.board.subnets.at(0).second, Bytes(16, 0x11));
  EXPECT_TRUE(rig.is_up());
  EXPECT_TRUE(rig.has_notice("sequence numbers start over"));
}

TEST(Orders, ResetBoardConfiguresBoardOfAnotherMesh) {
  ProvisioningRig rig;
  rig.board.unicast = 1;
  rig.board.subnets = {{std::uint16_t{0}, Bytes(16, 0x77)}};
  rig.start();
  ASSERT_FALSE(rig.is_up());
  rig.order(ResetBoardOrder{});
  rig.run_for(2s);
  EXPECT_TRUE(rig.is_up());
  EXPECT_EQ(rig.board.subnets.at(0).second, Bytes(16, 0x11));
  ProvisioningRig unplugged;
  unplugged.order(ResetBoardOrder{});
  EXPECT_NE(text_of(unplugged.answer()).find("link is down"), std::string::npos);
}

TEST(Orders, FailWithoutLinkAndWhenItGoesDown) {
  ProvisioningRig rig;
  rig.order(ScanOrder{});
  EXPECT_NE(text_of(rig.answer()).find("the BLE link is down"), std::string::npos);
  rig.start();
  rig.order(ScanOrder{});
  rig.mesh.on_port_closed("unplugged", rig.now);
  rig.run_for(1ms);
  EXPECT_NE(text_of(rig.answer()).find("unplugged"), std::string::npos);
}

TEST(Orders, ProvisionThatFailedWithLinkIsNotResumed) {
  ProvisioningRig rig(by_hand());
  rig.add(1);
  rig.start();
  rig.answers_stores = false;
  rig.order(ProvisionOrder{uuid_1, "lego-1"});
  rig.pass(2s);
  ASSERT_EQ(rig.on_disk().nodes.size(), 1u) << "it has an address";
  rig.mesh.on_port_closed("unplugged", rig.now);
  rig.run_for(1ms);
  EXPECT_NE(text_of(rig.answer()).find("unplugged"), std::string::npos) << rig.answer();
  rig.answers_stores = true;
  rig.mesh.on_stored({}, rig.now);
  rig.say(rig.board.restart());
  rig.open();
  rig.pass(30s);
  EXPECT_TRUE(rig.is_up());
  EXPECT_EQ(rig.board.devices.devices[0].address, 0);
}

TEST(Orders, ConfigReportsThatItIsKeptWhenLinkGoesDown) {
  JoinedRig rig;
  rig.device().deaf_to = {"80"};
  NodeConfigOrder order{"ble-0100"};
  order.ttl.emplace(7);
  rig.order(order);
  rig.pass(1s);
  rig.mesh.on_port_closed("unplugged", rig.now);
  rig.run_for(1ms);
  EXPECT_NE(text_of(rig.answer()).find("kept"), std::string::npos) << rig.answer();
}

TEST(Orders, ResetBoardEndsWhenTheBoardIsUnplugged) {
  JoinedRig rig;
  rig.board.ignored = {0xac};
  rig.order(ResetBoardOrder{});
  rig.run_for(1s);
  rig.mesh.on_port_closed("unplugged", rig.now);
  rig.run_for(1ms);
  EXPECT_NE(text_of(rig.answer()).find("unplugged"), std::string::npos) << rig.answer();
}

}  // namespace
}  // namespace slamgw::ble
