// SPDX-License-Identifier: Apache-2.0
// The mesh on BlueZ's meshd: joins, messages, and the state after each restart.
#include <gtest/gtest.h>

#include <algorithm>

#include "adapters/ble_mesh_bluez/meshd_radio.hpp"
#include "adapters/ble_mesh_usb_cdc/ble_mesh.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/mesh_json.hpp"
#include "tests/ble_mesh_bluez/fake_meshd.hpp"
#include "tests/ble_mesh_usb_cdc/event_log.hpp"
#include "tests/ble_mesh_usb_cdc/hex.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;

constexpr std::uint16_t robot = 0x0100;

struct MeshdRig : EventLog {
  explicit MeshdRig(std::optional<NodeDatabase> database = std::nullopt)
      : stored(std::move(database)) {
    start();
  }

  /// Starts a daemon with the stored state.
  void start() {
    const auto next_octets = [this](std::span<std::uint8_t> octets) {
      std::ranges::generate(octets, [this] { return ++random; });
      return true;
    };
    const auto next_key = [this](std::span<std::uint8_t> octets) {
      std::ranges::fill(octets, ++key_number);
      return true;
    };
    mesh = std::make_unique<BleMesh>(settings, TopicScheme("ntnu-slam", "gw"), RobotNames(), stored,
                                     std::make_unique<MeshdRadio>(settings, stored, next_octets),
                                     next_key);
    mesh->on_start();
  }
  void meshd_comes() { feed(MeshdCame{}); }
  void restart_meshd() {
    meshd.restart();
    feed(MeshdGone{"it is not running"});
    meshd_comes();
  }
  /// Restarts the daemon; leaving the bus ends its attachment.
  void restart_daemon() {
    meshd.restart();
    start();
    meshd_comes();
  }

  void feed(MeshdEvent event) {
    on_event(event);
    settle();
  }
  void on_event(MeshdEvent& event) {
    radio().on_event(event, now);
    mesh->settle(now);
  }
  MeshdRadio& radio() const { return static_cast<MeshdRadio&>(mesh->radio()); }
  void settle() {
    while (true) {
      if (auto action = mesh->next_action()) {  // in the order of MeshdAdapter
        perform(*action);
      } else if (auto request = radio().next_request()) {
        perform(*request);
      } else if (!meshd.events.empty()) {
        MeshdEvent event = std::move(meshd.events.front());
        meshd.events.pop_front();
        on_event(event);
      } else {
        return;
      }
    }
  }
  void perform(MeshdRequest& request) {
    std::visit(overloaded{
                   [this](const CallMeshd& call) { meshd.call(call); },
                   [this](const AcceptToken&) {
                     accepted_with = stored ? stored->life.radio : "";
                     meshd.accept_token();
                   },
                   [this](const GiveAddress& given) { meshd.give_address(given.address); },
                   [this](const Reconnect&) {
                     meshd.detach();
                     meshd.events.push_back(MeshdCame{});
                   },
               },
               request);
  }
  void perform(MeshAction& action) {
    if (auto* store = std::get_if<StoreMesh>(&action)) {
      if (disk_problem.empty()) stored = std::move(store->database);
      mesh->on_stored(disk_problem, now);
    } else if (auto* ended = std::get_if<OrderEnded>(&action)) {
      answers.push_back(ended->answer);
    } else if (auto* event = std::get_if<MeshEvent>(&action)) {
      events.push_back(std::move(*event));
    } else if (std::holds_alternative<WriteSerial>(action) ||
               std::holds_alternative<ReopenPort>(action)) {
      ADD_FAILURE() << "there is no serial port";
    }
  }
  void run_for(Duration time) {
    for (const TimePoint end = now + time; now < end; now += 20ms) {
      meshd.beacon();
      mesh->on_deadline(now);
      settle();
    }
  }
  void order(const BleOrder& what) {
    mesh->on_order(1, what, now);
    settle();
  }
  void command(const std::string& type, Bytes payload) {
    mesh->on_broker_message(
        {"ble-0100",
         {"ntnu-slam/server/ble-0100/" + type, std::move(payload), Qos::at_least_once, false},
         CommandId{1}},
        now);
    settle();
    run_for(100ms);
  }
  const FakeNode& node() const { return *meshd.attached(); }

  TimePoint now{};
  Settings settings;
  FakeMeshd meshd;
  std::optional<NodeDatabase> stored;
  std::string disk_problem;
  std::string accepted_with;
  std::unique_ptr<BleMesh> mesh;
  std::vector<OrderAnswer> answers;
  std::uint8_t random = 0;
  std::uint8_t key_number = 0;
};

struct RobotOnMeshd : MeshdRig {
  RobotOnMeshd() {
    meshd.robots.add(1);
    meshd_comes();
    run_for(10s);
  }
};

TEST(MeshdMesh, ARobotJoinsIsConfiguredHeardAndCommanded) {
  RobotOnMeshd rig;
  EXPECT_TRUE(rig.is_up());
  ASSERT_EQ(rig.stored->nodes.size(), 1u);
  EXPECT_EQ(rig.stored->nodes[0].state, NodeState::configured);
  EXPECT_EQ(rig.stored->nodes[0].device_key,
            Key(rig.node().remote_keys.empty() ? Key{} : *rig.stored->nodes[0].device_key));
  EXPECT_TRUE(
      std::ranges::equal(*rig.stored->nodes[0].device_key, rig.meshd.robots.devices[0].device_key));
  EXPECT_TRUE(std::ranges::equal(rig.stored->keys.app_key, rig.meshd.robots.devices[0].app_key));

  rig.meshd.say(robot, hex("c9 59 00 0a 00 ec ff"));
  rig.run_for(20ms);
  const auto reports = rig.all<Report>();
  ASSERT_EQ(reports.size(), 1u);
  EXPECT_EQ(reports[0].topic, "ntnu-slam/robot/ble-0100/update");
  ASSERT_TRUE(reports[0].radio);
  EXPECT_FALSE(reports[0].radio->rssi_dbm || reports[0].radio->ttl || reports[0].radio->hops);
  rig.mesh->on_receipt(reports[0].receipt.id, ReceiptOutcome::safe, rig.now);
  rig.run_for(100ms);
  ASSERT_FALSE(rig.meshd.sent.empty());
  EXPECT_EQ(rig.meshd.sent.back().payload, hex("cc 59 00 00"));

  rig.command("cmd", hex("01 00 02 00"));
  EXPECT_EQ(rig.meshd.sent.back().payload, hex("cd 59 00 01 00 02 00"));
  rig.meshd.say(robot, hex("d0 59 00 00"));
  rig.run_for(100ms);
  ASSERT_EQ(rig.all<CommandOutcome>().size(), 1u);
  EXPECT_EQ(rig.all<CommandOutcome>()[0].result, CommandResult::delivered);
  EXPECT_EQ(rig.meshd.broken_rules, std::set<std::string>{});
}

TEST(MeshdMesh, PreparesItsNode) {
  RobotOnMeshd rig;
  const FakeNode& node = rig.node();
  EXPECT_EQ(node.address, rig.settings.address);
  EXPECT_EQ(node.net_key, rig.stored->keys.net_key);
  EXPECT_EQ(node.own_app_key, rig.stored->keys.app_key);
  EXPECT_TRUE(node.is_bound);
  EXPECT_EQ(node.ttl, rig.settings.ttl);
  EXPECT_EQ(node.transmit, encode_transmissions(MeshdRadio::transmissions));
  EXPECT_EQ(node.subscriptions,
            std::set<std::uint16_t>(rig.settings.groups.begin(), rig.settings.groups.end()));
}

TEST(MeshdMesh, ATokenIsOnDiskBeforeItIsAccepted) {
  MeshdRig rig;
  rig.disk_problem = "the disk is full";
  rig.meshd_comes();
  rig.run_for(5s);
  EXPECT_FALSE(rig.is_up());
  EXPECT_EQ(rig.meshd.imports, 0) << "the address is not on disk either";
  rig.disk_problem.clear();
  rig.run_for(30s);
  EXPECT_TRUE(rig.is_up());
  EXPECT_EQ(rig.accepted_with, encode_node({rig.node().uuid, rig.meshd.nodes.begin()->first}));
}

TEST(MeshdMesh, RestartsKeepNodeAddressAndLife) {
  RobotOnMeshd rig;
  const auto once_more = [&](const char* what) {
    SCOPED_TRACE(what);
    rig.run_for(5s);
    EXPECT_TRUE(rig.is_up());
    EXPECT_EQ(rig.node().address, rig.settings.address);
    EXPECT_EQ(rig.stored->life.number, 1u);
    EXPECT_EQ(rig.stored->life.kind, RadioKind::keeps);
    EXPECT_EQ(rig.meshd.imports, 1);
    rig.meshd.robots.devices[0].requests.clear();
    rig.events.clear();
    rig.meshd.say(robot, hex("c9 59 00 0a 00 ec ff"));
    rig.run_for(20ms);
    EXPECT_EQ(rig.all<Report>().size(), 1u);
    EXPECT_TRUE(rig.meshd.robots.devices[0].requests.empty()) << "the robot is configured already";
  };
  rig.restart_meshd();
  once_more("meshd");
  rig.restart_daemon();
  once_more("the daemon");
  rig.restart_meshd();
  rig.restart_daemon();
  once_more("both");
  EXPECT_EQ(rig.meshd.broken_rules, std::set<std::string>{});
}

TEST(MeshdMesh, CreatesNodeAtNextAddressWhenMeshdHasLostIt) {
  RobotOnMeshd rig;
  rig.meshd.nodes.clear();
  rig.restart_meshd();
  rig.run_for(10s);
  EXPECT_TRUE(rig.is_up());
  EXPECT_TRUE(rig.has_notice("has lost the gateway's node"));
  EXPECT_EQ(rig.node().address, rig.settings.address + 1);
  EXPECT_EQ(rig.stored->life.number, 2u);
  EXPECT_EQ(rig.stored->nodes[0].applied->destination, rig.settings.address + 1) << "robots follow";
  rig.restart_daemon();
  rig.run_for(5s);
  EXPECT_EQ(rig.node().address, rig.settings.address + 1);
  EXPECT_EQ(rig.meshd.broken_rules, std::set<std::string>{});
}

TEST(MeshdMesh, ReplacesNodeWhoseSequenceNumberWentBack) {
  RobotOnMeshd rig;
  rig.meshd.nodes.begin()->second.is_replaying = true;  // as after a power cut
  rig.restart_meshd();
  rig.run_for(30s);
  EXPECT_TRUE(rig.is_up());
  EXPECT_EQ(rig.meshd.nodes.size(), 1u);
  EXPECT_EQ(rig.node().address, rig.settings.address + 1);
  EXPECT_EQ(rig.stored->nodes[0].applied->destination, rig.settings.address + 1) << "robots follow";
  EXPECT_EQ(rig.meshd.broken_rules, std::set<std::string>{});
}

TEST(MeshdMesh, ContinuesMeshOfSerialBoard) {
  NodeDatabase database;
  database.keys.net_key.fill(7);
  database.keys.app_key.fill(8);
  database.iv_index = 3;
  database.life = {2, 0x0002, "00112233445566778899aabbccddeeff", RadioKind::forgets};
  Node known;
  known.uuid = {1};
  known.address = robot;
  known.state = NodeState::configured;
  known.device_key.emplace().fill(9);
  known.ttl = Settings{}.ttl;
  known.applied = AppliedSettings{0x0002, Settings{}.groups};
  database.nodes.push_back(known);

  MeshdRig rig(database);
  FakeDevice& device = rig.meshd.robots.add(1);
  device.address = robot;
  device.device_key = Bytes(16, 9);
  device.net_key = Bytes(16, 7);
  rig.meshd_comes();
  rig.run_for(10s);
  EXPECT_TRUE(rig.is_up());
  EXPECT_EQ(rig.node().address, 0x0003);
  EXPECT_EQ(rig.node().iv_index, 3u);
  EXPECT_EQ(rig.stored->nodes[0].applied->destination, 0x0003);
  EXPECT_EQ(rig.meshd.broken_rules, std::set<std::string>{});
}

TEST(MeshdMesh, CreatesAnotherNodeWhenConfiguredAddressChanges) {
  RobotOnMeshd rig;
  rig.settings.address = 0x0020;
  rig.restart_daemon();
  rig.run_for(10s);
  EXPECT_TRUE(rig.is_up());
  EXPECT_GE(rig.node().address, 0x0020);
  EXPECT_EQ(rig.meshd.nodes.size(), 1u);
}

TEST(MeshdMesh, WaitsForAMeshdWithoutAController) {
  MeshdRig rig;
  rig.meshd.is_without_controller = true;
  rig.meshd_comes();
  rig.run_for(10s);
  ASSERT_FALSE(rig.is_up());
  EXPECT_NE(rig.all<LinkChange>().back().detail.find("waits for its Bluetooth controller"),
            std::string::npos);
  rig.meshd.is_without_controller = false;
  rig.run_for(5s);
  EXPECT_TRUE(rig.is_up());
}

TEST(MeshdMesh, ReportsDeviceForEachScanAndItsSignalOnlyWhenKnown) {
  MeshdRig rig;
  rig.settings.provisioning.enabled = false;
  rig.start();
  rig.meshd.robots.add(1);
  rig.meshd.rssi = 127;
  rig.meshd_comes();
  rig.order(ScanOrder{});
  rig.run_for(20s);
  ASSERT_EQ(rig.answers.size(), 1u);
  EXPECT_NE(rig.answers[0].json.find(R"("rssi_dbm":null,"heard_s_ago":)"), std::string::npos)
      << rig.answers[0].json;
  rig.meshd.rssi = -60;
  rig.order(ScanOrder{});
  rig.run_for(20s);
  ASSERT_EQ(rig.answers.size(), 2u);
  EXPECT_NE(rig.answers[1].json.find(R"("rssi_dbm":-60)"), std::string::npos);
}

TEST(MeshdMesh, RetriesDeviceThatFailsToJoin) {
  MeshdRig rig;
  rig.meshd.robots.add(1);
  rig.meshd.fails_to_join = "bad-pdu";
  rig.meshd_comes();
  rig.run_for(2s);
  EXPECT_TRUE(rig.has_notice("bluetooth-meshd gave up: bad-pdu"));
  rig.run_for(20s);
  ASSERT_EQ(rig.stored->nodes.size(), 1u);
  EXPECT_EQ(rig.stored->nodes[0].state, NodeState::configured);
  EXPECT_EQ(rig.meshd.broken_rules, std::set<std::string>{});
}

TEST(MeshdMesh, IgnoresItsOwnMessagesToGroup) {
  RobotOnMeshd rig;
  rig.meshd.events.push_back(AppMessage{rig.node().address, 0, hex("c9 59 00 0a 00 ec ff")});
  rig.run_for(20ms);
  EXPECT_TRUE(rig.all<Report>().empty());
}

TEST(MeshdMesh, WarnsOfAResetThatFailsAfterItsOrderHasEnded) {
  MeshdRig rig;
  rig.meshd_comes();
  rig.meshd.does_not_answer = true;
  rig.order(ResetBoardOrder{});
  rig.run_for(21s);
  EXPECT_EQ(rig.answers.size(), 1u);
  rig.feed(MeshdGone{"it is not running"});
  EXPECT_TRUE(rig.has_notice("the radio was not cleared"));
}

TEST(MeshdMesh, ResetBoardReplacesNode) {
  RobotOnMeshd rig;
  const Uuid before = rig.node().uuid;
  rig.order(ResetBoardOrder{});
  rig.run_for(10s);
  ASSERT_EQ(rig.answers.size(), 1u);
  EXPECT_EQ(rig.answers[0].error, "");
  EXPECT_NE(rig.node().uuid, before);
  EXPECT_EQ(rig.node().address, rig.settings.address + 1);
  EXPECT_EQ(rig.meshd.nodes.size(), 1u);
}

TEST(MeshdMesh, TakesTheAddressOfAnEarlierNodeForTheDefault) {
  RobotOnMeshd rig;
  rig.settings.radio = RadioChoice::bluez;
  rig.restart_daemon();
  rig.order(ResetBoardOrder{});
  rig.run_for(10s);
  ASSERT_EQ(rig.node().address, 0x0002);
  NodeConfigOrder order{"ble-0100"};
  for (const std::uint16_t address : {std::uint16_t{0x0002}, std::uint16_t{0x0001}}) {
    order.publish = {"sensor_update", address};
    rig.order(order);
    rig.run_for(20s);
    const std::string& answer = rig.answers.back().json;
    EXPECT_EQ(answer.find("does not hear"), std::string::npos) << answer;
    EXPECT_NE(answer.find(R"("wanted":{})"), std::string::npos) << answer;
  }
}

TEST(MeshdMesh, KeyRefreshGivesNodeAndRobotsNewKeys) {
  RobotOnMeshd rig;
  const Key before = rig.stored->keys.net_key;
  rig.order(RefreshKeysOrder{});
  rig.run_for(60s);
  EXPECT_TRUE(rig.is_up());
  EXPECT_FALSE(rig.stored->refresh) << "the refresh has ended";
  EXPECT_NE(rig.stored->keys.net_key, before);
  EXPECT_EQ(rig.node().net_key, rig.stored->keys.net_key);
  EXPECT_EQ(rig.node().own_app_key, rig.stored->keys.app_key);
  EXPECT_TRUE(std::ranges::equal(rig.meshd.robots.devices[0].net_key, rig.stored->keys.net_key));
  EXPECT_EQ(rig.meshd.broken_rules, std::set<std::string>{});
}

TEST(MeshdMesh, ReconnectsToMeshdThatDidNotAnswer) {
  RobotOnMeshd rig;
  rig.meshd.is_without_controller = true;
  rig.run_for(MeshdRadio::iv_index_interval);
  EXPECT_FALSE(rig.is_up());
  rig.meshd.is_without_controller = false;
  rig.run_for(10s);
  EXPECT_TRUE(rig.is_up()) << "although meshd still had the node attached";
  EXPECT_EQ(rig.meshd.imports, 1);
  for (const LinkChange& change : rig.all<LinkChange>())
    EXPECT_EQ(change.detail.find("has restarted"), std::string::npos) << "the gateway left the bus";
}

TEST(MeshdMesh, ReportsLinkDownWhenMeshdRestartsWithoutPause) {
  RobotOnMeshd rig;
  rig.events.clear();
  rig.meshd.restart();
  rig.meshd_comes();
  rig.run_for(2s);
  const auto changes = rig.all<LinkChange>();
  ASSERT_EQ(changes.size(), 2u);
  EXPECT_FALSE(changes[0].is_up);
  EXPECT_TRUE(changes[1].is_up);
}

TEST(MeshdMesh, EndsCommandsWhenMeshdGoesAway) {
  RobotOnMeshd rig;
  rig.meshd.does_not_answer = true;
  rig.command("cmd", hex("01 00 02 00"));
  rig.feed(MeshdGone{"it is not running"});
  EXPECT_FALSE(rig.is_up());
  ASSERT_EQ(rig.all<CommandOutcome>().size(), 1u);
  EXPECT_NE(rig.all<CommandOutcome>()[0].result, CommandResult::delivered);
}

TEST(MeshdNode, IsReadAsItWasWritten) {
  MeshdNode node;
  node.uuid.fill(0xa5);
  EXPECT_EQ(decode_node(encode_node(node))->uuid, node.uuid);
  EXPECT_FALSE(decode_node(encode_node(node))->token);
  node.token = 0x815320361e31bae0;
  EXPECT_EQ(encode_node(node), "bluez a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5 815320361e31bae0");
  EXPECT_EQ(decode_node(encode_node(node))->token, node.token);
  for (const char* other : {"", "bluez", "bluez a5", "00112233445566778899aabbccddeeff",
                            "bluez a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5a5 xyz"})
    EXPECT_FALSE(decode_node(other)) << other;
}

}  // namespace
}  // namespace slamgw::ble
