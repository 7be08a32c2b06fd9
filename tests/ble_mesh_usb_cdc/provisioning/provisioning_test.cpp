// SPDX-License-Identifier: Apache-2.0
// Provisioning of devices: each failure, and the state that survives a crash.
#include <gtest/gtest.h>

#include "adapters/ble_mesh_usb_cdc/provisioning/mesh_json.hpp"
#include "tests/ble_mesh_usb_cdc/provisioning_rig.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;

Settings with_prefixes(std::vector<std::string> prefixes) {
  Settings settings;
  settings.provisioning.uuid_prefixes = std::move(prefixes);
  return settings;
}

TEST(Provisioning, ProvisionsAndConfiguresTenRobots) {
  ProvisioningRig rig;
  for (std::uint8_t number = 1; number <= 10; ++number) rig.add(number);
  rig.start();
  EXPECT_TRUE(rig.all_configured(30s));
  for (std::uint16_t address = 0x0100; address < 0x010a; ++address) {
    ASSERT_NE(rig.board.devices.at(address), nullptr) << address;
    EXPECT_EQ(rig.board.devices.at(address)->app_key, Bytes(16, 0x22));
  }
  EXPECT_TRUE(rig.board.devices.device_keys.empty()) << "no device key is left on the board";
  EXPECT_LE(rig.board.devices.most_device_keys, NodeConversations::max_conversations);
  EXPECT_TRUE(rig.board.devices.is_scanning) << "for devices that appear later";
}

TEST(Provisioning, ProvisionsRobotsThatAppearLater) {
  ProvisioningRig rig;
  rig.start();
  rig.pass(30s);
  rig.add(1);
  EXPECT_TRUE(rig.all_configured(10s));
}

TEST(Provisioning, IgnoresOtherUuidPrefixesAndDoesNotScanWhenDisabled) {
  ProvisioningRig rig(with_prefixes({"ABCD", "736c616d01"}));
  rig.add(1);
  rig.add(2);
  rig.start();
  rig.pass(20s);
  EXPECT_NE(rig.board.devices.devices[0].address, 0);
  EXPECT_EQ(rig.board.devices.devices[1].address, 0);
  Settings off;
  off.provisioning.enabled = false;
  ProvisioningRig idle(off);
  idle.add(1);
  idle.start();
  idle.pass(20s);
  EXPECT_EQ(idle.board.count(0x61), 0u);
}

TEST(Provisioning, ProvisionsOnlyDevicesWithStaticOob) {
  Settings settings;
  settings.provisioning.static_oob = "000102030405060708090a0b0c0d0e0f";
  ProvisioningRig rig(settings);
  rig.add(1);
  rig.add(2);
  rig.add(3).static_oob = hex("00 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d 0e 0f");
  rig.start();
  rig.pass(30s);
  for (const std::size_t stranger : {0u, 1u})
    EXPECT_EQ(rig.board.devices.devices[stranger].address, 0) << "it would get the mesh's keys";
  EXPECT_NE(rig.board.devices.devices[2].address, 0)
      << "other devices do not occupy the board's links";
  EXPECT_TRUE(rig.has_notice("says that it has no static OOB"));
  EXPECT_FALSE(rig.has_notice("still busy with earlier provisioning links"));
}

TEST(Provisioning, ReportsWrongStaticOobWithoutShowingIt) {
  Settings settings;
  settings.provisioning.static_oob = "ffffffffffffffffffffffffffffffff";
  ProvisioningRig rig(settings);
  rig.add(1).static_oob = Bytes(16, 7);
  rig.start();
  rig.pass(10s);
  EXPECT_TRUE(rig.has_notice("ble_mesh.provisioning.static_oob"));
  EXPECT_FALSE(rig.has_notice("ffffffff"));
}

TEST(Provisioning, RecoversFromEachLostAnswer) {
  ProvisioningRig whole;
  whole.add(1);
  whole.start();
  ASSERT_TRUE(whole.all_configured(20s));
  const std::size_t commands = whole.board.commands.size();
  for (std::size_t lost = 0; lost < commands; ++lost) {
    ProvisioningRig rig;
    rig.add(1);
    rig.board.ignore_command_number = lost;
    rig.start();
    if (whole.board.commands[lost] == 0x68) {  // the device key is lost with this answer
      rig.pass(30s);
      EXPECT_TRUE(rig.has_notice("reset by hand"));
      rig.reset_lost_devices();
    }
    EXPECT_TRUE(rig.all_configured(120s))
        << "command " << lost << ", opcode " << int{whole.board.commands[lost]};
  }
}

TEST(Provisioning, TriesAgainAfterEachLostEvent) {
  for (const std::uint8_t event : std::initializer_list<std::uint8_t>{0xc1, 0xc2, 0xc3, 0xc7}) {
    ProvisioningRig rig;
    rig.add(1);
    rig.board.devices.lost_events = {event};
    rig.start();
    EXPECT_TRUE(rig.all_configured(60s)) << int{event};
  }
}

TEST(Provisioning, ReportsThatRobotWithLostKeyMustBeResetByHand) {
  ProvisioningRig rig;
  rig.add(1);
  rig.board.devices.lost_events = {0xc5, 0xc2};
  rig.start();
  rig.pass(30s);
  EXPECT_TRUE(rig.has_notice("reset by hand"));
  EXPECT_TRUE(rig.on_disk().nodes.empty());
  rig.board.devices.devices[0].address = 0;  // which is done
  EXPECT_TRUE(rig.all_configured(30s));
}

TEST(Provisioning, AnnouncesNoNextAttemptForRobotWithLostKey) {
  ProvisioningRig rig;
  rig.add(1);
  rig.board.devices.lost_events = {0xc5};  // the link's end is reported
  rig.start();
  rig.pass(30s);
  EXPECT_TRUE(rig.has_notice("its device key was lost on the serial line; reset it by hand"));
  EXPECT_FALSE(rig.has_notice("next attempt"));
  rig.board.devices.devices[0].address = 0;  // which is done
  EXPECT_TRUE(rig.all_configured(30s));
}

/// The board's report that the device at 0x0100 has joined, as it was recorded
/// (tests/vectors/nordic_board), with another network key.
Bytes join_report(const Key& net_key, std::uint8_t context = 1) {
  return hex("2c c5") + Bytes{context} + hex("00 00 00 00 00 00 00 01 00 00") + Bytes(16, 0x4f) +
         Bytes(net_key.begin(), net_key.end());
}

NodeDatabase with_reserved_node() {
  NodeDatabase database = test_database();
  Node& node = database.nodes.emplace_back();
  node.uuid = *parse_uuid("736c616d010101010101010101010101");
  node.address = 0x0100;
  database.next_address = 0x0101;
  return database;
}

/// The daemon was restarted after it had given the board the secret.
TEST(Provisioning, TakesTheKeyOfADeviceThatJoinedWithoutTheDaemon) {
  ProvisioningRig rig({}, with_reserved_node());
  rig.add(1).address = 0x0100;
  rig.board.devices.devices[0].device_key = Bytes(16, 0x4f);
  rig.start();
  rig.say(join_report(test_keys().net_key));
  EXPECT_TRUE(rig.has_notice("ble-0100 is in the mesh, at 0x0100"));
  EXPECT_TRUE(rig.all_configured(20s));
  EXPECT_EQ(to_hex(rig.on_disk().nodes.at(0).device_key.value_or(Key{})), to_hex(Bytes(16, 0x4f)));
}

TEST(Provisioning, TakesTheKeyAlsoBeforeTheLinkIsUp) {
  ProvisioningRig rig({}, with_reserved_node());
  rig.mesh.on_start();
  rig.open();
  while (rig.board.count(0x09) == 0) rig.run_for(1ms);
  ASSERT_FALSE(rig.is_up());
  rig.say(join_report(test_keys().net_key));
  EXPECT_EQ(rig.on_disk().nodes.at(0).state, NodeState::provisioned);
}

TEST(Provisioning, IgnoresKeysOfOtherMeshesAndOfJoinedNodes) {
  ProvisioningRig rig({}, with_reserved_node());
  rig.start();
  rig.say(join_report(Key{}));
  EXPECT_EQ(rig.on_disk().nodes.at(0).state, NodeState::reserved);
  NodeDatabase database = with_reserved_node();
  database.nodes[0].state = NodeState::configured;
  database.nodes[0].device_key = Key{7};
  ProvisioningRig joined({}, database);
  joined.start();
  joined.say(join_report(test_keys().net_key));
  EXPECT_EQ(joined.on_disk().nodes.at(0).device_key, Key{7});
  ProvisioningRig other({}, test_database());
  other.start();
  other.say(join_report(test_keys().net_key));
  EXPECT_TRUE(other.on_disk().nodes.empty());
}

TEST(Provisioning, WarnsAtTheStartOfADeviceThatMayHaveJoined) {
  NodeDatabase database = with_reserved_node();
  database.nodes[0].is_joining = true;
  const auto stored = decode_node_database(encode_node_database(database));
  ASSERT_TRUE(stored.has_value());
  ProvisioningRig rig({}, *stored);
  rig.start();
  const std::string warning = "it was joining when the gateway ended";
  EXPECT_EQ(rig.count_notices("ble-0100 (UUID 736c616d010101010101010101010101): " + warning), 1);
  rig.order(NodesOrder{});
  EXPECT_NE(rig.answer().at(0)["problem"].dump().find(warning), std::string::npos);
  rig.add(1);  // which it was not, or was reset
  EXPECT_TRUE(rig.all_configured(20s));
  EXPECT_FALSE(rig.on_disk().nodes.at(0).is_joining);
  rig.order(NodesOrder{});
  EXPECT_EQ(rig.answer().at(0)["problem"], "");
}

TEST(Provisioning, DoesNotSuspectADeviceThatDidNotJoin) {
  ProvisioningRig rig;
  rig.add(1);
  rig.board.devices.fails_at = {0xc7, 0x05};
  rig.start();
  while (rig.board.count(0x63) == 0) rig.pass(500ms);
  EXPECT_TRUE(rig.stored.at(rig.stored.size() - 2).nodes.at(0).is_joining);
  EXPECT_FALSE(rig.on_disk().nodes.at(0).is_joining);
}

/// The device has its address, but the port closes before the gateway knows.
TEST(Provisioning, ReportsPossibleJoinWhenLinkBreaksInLastStep) {
  ProvisioningRig rig;
  rig.add(1);
  rig.board.devices.lost_events = {0xc5, 0xc2};
  rig.start();
  while (rig.board.devices.devices[0].address == 0) rig.pass(100ms);
  EXPECT_FALSE(rig.has_notice("reset by hand"));
  rig.mesh.on_port_closed("unplugged", rig.now);
  rig.run_for(1ms);
  EXPECT_TRUE(
      rig.has_notice("the BLE link went down: unplugged; if the device took its address "
                     "nevertheless, it has to be reset by hand"));
  EXPECT_TRUE(rig.on_disk().nodes.empty()) << "other devices get the address last";
}

TEST(Provisioning, AsksForNoResetWhenLinkBreaksEarlier) {
  ProvisioningRig rig;
  rig.add(1);
  rig.board.devices.lost_events = {0xc7};  // the device's public key
  rig.start();
  rig.pass(5s);
  rig.mesh.on_port_closed("unplugged", rig.now);
  rig.run_for(1ms);
  EXPECT_TRUE(rig.has_notice("the BLE link went down: unplugged"));
  EXPECT_FALSE(rig.has_notice("reset by hand"));
}

TEST(Provisioning, ReportsBoardsDroppedEventsWhenKeyWasLost) {
  ProvisioningRig rig;
  rig.add(1);
  rig.board.devices.lost_events = {0xc5};
  rig.board.dropped = 100;
  rig.start();
  rig.board.dropped += 12;
  rig.pass(5s);
  EXPECT_TRUE(rig.has_notice("the serial board has dropped 12 event(s) since it was started up"));
  ProvisioningRig old;
  old.add(1);
  old.board.devices.lost_events = {0xc5};
  old.board.status_of[0x14] = 0x82;  // the command came with release 2.2.0
  old.start();
  old.pass(5s);
  EXPECT_TRUE(old.has_notice("its device key was lost on the serial line; reset it by hand"));
  EXPECT_FALSE(old.has_notice("has dropped"));
}

/// The robot has the address until it is reset, and must not share it.
TEST(Provisioning, ReusesAddressOfRobotWithLostKeyLast) {
  ProvisioningRig rig;
  rig.add(1);
  rig.board.devices.lost_events = {0xc5};
  rig.start();
  rig.pass(5s);
  EXPECT_TRUE(rig.on_disk().nodes.empty()) << "the address is not reserved any more";
  rig.add(2);
  rig.pass(20s);
  EXPECT_EQ(rig.board.devices.devices[1].address, 0x0101);
  rig.board.devices.devices[0].address = 0;  // reset by hand: it may join
  EXPECT_TRUE(rig.all_configured(30s));
  EXPECT_EQ(rig.board.devices.devices[0].address, 0x0102);
}

TEST(Provisioning, KeepsNameOfRobotWithLostKey) {
  ProvisioningRig rig({}, test_database(), RobotNames({{"one", 0x0200, {}}}));
  rig.add(1);
  rig.board.devices.lost_events = {0xc5};
  rig.start();
  rig.pass(5s);
  rig.board.devices.devices[0].address = 0;  // reset by hand
  EXPECT_TRUE(rig.all_configured(30s));
  EXPECT_EQ(rig.board.devices.devices[0].address, 0x0200);
}

TEST(Provisioning, ReportsEachFailureAndTriesOtherDevicesFirst) {
  for (const std::uint8_t event : std::initializer_list<std::uint8_t>{0xc1, 0xc3, 0xc7, 0xc5}) {
    ProvisioningRig rig;
    rig.add(1);
    rig.add(2);
    rig.board.devices.closes_at = event;
    rig.start();
    EXPECT_TRUE(rig.all_configured(60s)) << int{event};
    EXPECT_TRUE(rig.has_notice("did not join: the provisioning link ended")) << int{event};
    EXPECT_EQ(rig.board.devices.devices[0].address, 0x0100) << "it keeps its address";
    EXPECT_EQ(rig.stored.back().nodes.size(), 2u);
  }
  ProvisioningRig rig;
  rig.add(1);
  rig.board.devices.fails_at = {0xc7, 0x05};
  rig.start();
  EXPECT_TRUE(rig.all_configured(60s));
  EXPECT_TRUE(rig.has_notice("out of resources (0x05)"));
}

TEST(Provisioning, WaitsLongerAfterEachFailure) {
  ProvisioningRig rig;
  rig.add(1);
  rig.board.status_of[0x63] = 0x86;
  rig.start();
  rig.pass(100s);
  const auto attempts = rig.board.count(0x63);
  EXPECT_GE(attempts, 4u);
  EXPECT_LE(attempts, 6u) << "at about 0, 5, 15, 35, 75 s";
  EXPECT_TRUE(rig.has_notice("\"busy\" (0x86) to command 0x63"));
}

TEST(Provisioning, UsesOtherContextWhileOneIsBusy) {
  for (const std::uint8_t context : std::initializer_list<std::uint8_t>{0, 1}) {
    ProvisioningRig rig;
    rig.add(1);
    rig.board.devices.busy_contexts = {context};
    rig.start();
    EXPECT_TRUE(rig.all_configured(3s)) << int{context};
  }
  ProvisioningRig rig;
  rig.add(1);
  rig.board.devices.busy_contexts = {0, 1};
  rig.start();
  rig.pass(4s);
  EXPECT_EQ(rig.board.count(0x63), 2u);
  EXPECT_TRUE(rig.has_notice("still busy with earlier provisioning links"));
  rig.board.devices.busy_contexts.clear();
  EXPECT_TRUE(rig.all_configured(10s));
}

TEST(Provisioning, TriesAgainWhenTheBoardRefusesToScan) {
  ProvisioningRig rig;
  rig.board.status_of[0x61] = 0x86;
  rig.start();
  rig.run_for(70s);
  EXPECT_FALSE(rig.board.devices.is_scanning);
  EXPECT_EQ(rig.board.count(0x61), 3u);
  EXPECT_EQ(rig.count_notices("does not start scanning for new robots"), 1);
  rig.board.status_of.clear();
  rig.run_for(30s);
  EXPECT_TRUE(rig.board.devices.is_scanning);
}

TEST(Provisioning, ContinuesAfterBoardRestartsAtAnyMoment) {
  for (int moment = 0; moment < 40; ++moment) {
    ProvisioningRig rig;
    rig.add(1);
    rig.start();
    while (!rig.board.devices.is_scanning) rig.run_for(1ms);
    rig.say(rig.board.devices.beacons());
    rig.run_for(5ms * moment);
    rig.say(rig.board.restart());
    rig.pass(2s);
    rig.reset_lost_devices();  // the key was lost with the restart
    EXPECT_TRUE(rig.all_configured(120s)) << moment;
  }
}

/// The board finishes without its host once it has the secret (68), and reports the key once.
TEST(Provisioning, AStopAtAnyMomentLosesNoDeviceKey) {
  int finished = 0;
  for (int moment = 0; moment < 40; ++moment) {
    ProvisioningRig rig;
    rig.add(1);
    rig.start();
    while (!rig.board.devices.is_scanning) rig.run_for(1ms);
    rig.say(rig.board.devices.beacons());
    rig.run_for(2ms * moment);
    const auto secrets = rig.board.count(0x68);
    rig.stop();
    rig.pass(10s);
    const FakeDevice& device = rig.board.devices.devices[0];
    EXPECT_EQ(rig.board.count(0x68), secrets) << moment;
    if (secrets == 0) {
      const NodeDatabase* unsaved = rig.mesh.unsaved();  // the shell writes it
      for (const Node& node : (unsaved != nullptr ? *unsaved : rig.on_disk()).nodes)
        EXPECT_FALSE(node.is_joining) << moment;
      EXPECT_EQ(device.address, 0) << moment;
      continue;
    }
    ++finished;
    ASSERT_TRUE(rig.on_disk().nodes.at(0).device_key) << moment;
    EXPECT_EQ(to_hex(*rig.on_disk().nodes[0].device_key), to_hex(device.device_key)) << moment;
  }
  EXPECT_TRUE(0 < finished && finished < 40) << finished;
}

TEST(Provisioning, AStopWaitsForADeviceThatHasTheSecret) {
  for (const std::uint8_t last : std::initializer_list<std::uint8_t>{0x63, 0x68}) {
    ProvisioningRig rig;
    rig.add(1);
    rig.start();
    rig.say(rig.board.devices.beacons());
    while (rig.board.count(last) == 0) rig.run_for(1ms);
    EXPECT_FALSE(rig.mesh.is_settled());
    rig.stop();
    EXPECT_EQ(rig.mesh.is_settled(), last == 0x63) << int{last};
    rig.run_for(10ms);
    EXPECT_TRUE(rig.mesh.is_settled());
    EXPECT_EQ(rig.on_disk().nodes.at(0).device_key.has_value(), last == 0x68);
  }
}

TEST(Provisioning, StoresAddressesBeforeDevicesGetThemAndKeysBeforeTheirUse) {
  ProvisioningRig rig;
  rig.add(1);
  rig.start();
  rig.stored.clear();
  rig.answers_stores = false;  // the disk is slow
  rig.pass(2s);
  ASSERT_EQ(rig.stored.size(), 1u);
  EXPECT_EQ(rig.stored[0].nodes.at(0).address, 0x0100);
  EXPECT_EQ(rig.board.count(0x63), 0u);
  rig.mesh.on_stored("", rig.now);
  rig.pass(2s);
  EXPECT_EQ(rig.board.count(0x63), 1u);
  ASSERT_EQ(rig.stored.size(), 2u);
  EXPECT_NE(rig.mesh.unsaved(), nullptr) << "a clean shutdown writes it";
  EXPECT_EQ(rig.stored[1].nodes.at(0).state, NodeState::provisioned);
  EXPECT_EQ(to_hex(*rig.stored[1].nodes[0].device_key),
            to_hex(rig.board.devices.devices[0].device_key));
  EXPECT_EQ(rig.board.count(0x9c), 0u);
  rig.mesh.on_stored("", rig.now);
  rig.pass(2s);
  EXPECT_EQ(rig.board.count(0x9c), 1u);
}

TEST(Provisioning, ProvisionsNoRobotWhileDiskIsFull) {
  ProvisioningRig rig;
  rig.add(1);
  rig.start();
  rig.store_problem = "mesh.json can't be stored: no space";
  rig.pass(20s);
  EXPECT_EQ(rig.board.count(0x63), 0u);
  EXPECT_EQ(rig.count_notices("no space"), 1);
  rig.store_problem.clear();
  EXPECT_TRUE(rig.all_configured(20s));
}

TEST(Provisioning, ACrashAtAnyMomentLosesNoRobotAndNoAddress) {
  ProvisioningRig whole;
  whole.add(1);
  whole.add(2);
  whole.start();
  ASSERT_TRUE(whole.all_configured(30s));
  for (std::size_t crash = 0; crash < whole.stored.size(); ++crash) {
    ProvisioningRig first;
    first.add(1);
    first.add(2);
    first.start();
    while (first.stored.size() <= crash) {
      first.run_for(5ms);
      if (const Bytes beacons = first.board.devices.beacons(); !beacons.empty()) first.say(beacons);
    }
    // The daemon is killed as soon as this state is on disk; the board and the devices keep
    // running.
    const auto on_disk = decode_node_database(encode_node_database(first.stored[crash]));
    ASSERT_TRUE(on_disk.has_value());
    ProvisioningRig second({}, *on_disk);
    second.board = first.board;
    second.start();
    EXPECT_TRUE(second.all_configured(60s)) << crash;
    std::set<std::uint16_t> addresses;
    for (const FakeDevice& device : second.board.devices.devices) addresses.insert(device.address);
    EXPECT_EQ(addresses, (std::set<std::uint16_t>{0x0100, 0x0101})) << crash;
  }
}

TEST(Provisioning, AssignsAddressToEachElement) {
  ProvisioningRig rig;
  rig.add(1).elements = 3;
  rig.add(2);
  rig.start();
  EXPECT_TRUE(rig.all_configured(30s));
  EXPECT_EQ(rig.board.devices.devices[1].address, 0x0103);
  rig.hear(0x0102, "c9 59 00 01 00 02 00");
  EXPECT_EQ(rig.all<Report>().back().robot, "ble-0100") << "each element belongs to the robot";
  EXPECT_EQ(rig.all<Report>().back().radio->rssi_dbm, -55);
  EXPECT_EQ(rig.all<Report>().back().radio->hops, 0) << "it was sent with the configured TTL";
  rig.receipt(rig.all<Report>().back().receipt.id);
  rig.run_for(1s);
  EXPECT_EQ(rig.sent_to(0x0102), std::vector<std::string>{"cc590000"});
}

TEST(Provisioning, MovesDeviceWhoseElementsDoNotFit) {
  const RobotNames names({{"a", 0x0200, {}}, {"b", 0x0201, {}}});
  ProvisioningRig rig({}, test_database(), names);
  rig.add(1);
  rig.start();
  ASSERT_TRUE(rig.all_configured(20s));
  NodeDatabase database = rig.stored.back();
  database.nodes[0].address = 0x0201;
  ProvisioningRig next({}, database, names);
  next.add(2).elements = 2;  // 0x0200 is free, 0x0201 is not
  next.start();
  next.pass(60s);
  EXPECT_EQ(next.board.devices.devices[0].address, 0x0100);
  EXPECT_TRUE(next.has_notice("as many addresses in a row"));
}

TEST(Provisioning, NamesRobotsAsTheConfigurationDoes) {
  ProvisioningRig rig({}, test_database(), RobotNames({{"one", 0x0200, {}}, {"two", 0x0101, {}}}));
  for (std::uint8_t number = 1; number <= 3; ++number) rig.add(number);
  rig.start();
  EXPECT_TRUE(rig.all_configured(30s));
  EXPECT_EQ(rig.board.devices.devices[0].address, 0x0200);
  EXPECT_EQ(rig.board.devices.devices[1].address, 0x0101);
  EXPECT_EQ(rig.board.devices.devices[2].address, 0x0100);
  EXPECT_TRUE(rig.has_notice("two is configured"));
}

TEST(Provisioning, ProvisionsResetRobotUnderItsNameAtNewAddress) {
  ProvisioningRig rig;
  rig.add(1);
  rig.start();
  ASSERT_TRUE(rig.all_configured(20s));
  rig.hear(0x0100, "cb 59 00 01 00 02 00");
  FakeDevice& device = rig.board.devices.devices[0];
  device.address = 0;
  device.requests.clear();
  rig.pass(22s);  // a robot that only publishes its health is heard each 10 s
  EXPECT_EQ(device.address, 0) << "the robot may still be there, and another device use its UUID";
  rig.pass(10s);
  EXPECT_EQ(device.address, 0x0101) << "the board's replay list would ignore it at 0x0100";
  EXPECT_FALSE(device.requests.empty());
  EXPECT_EQ(rig.board.count(0x0e), 0u) << "the board is not restarted";
  EXPECT_TRUE(rig.has_notice("ble-0100 is in the mesh, at 0x0101"));
  rig.hear(0x0101, "cb 59 00 01 00 02 00");
  EXPECT_EQ(rig.all<Report>().back().robot, "ble-0100");
  rig.command("ble-0100/cmd", hex("0a 00 ec ff"));
  rig.run_for(100ms);
  EXPECT_FALSE(rig.sent_to(0x0101).empty()) << "commands use the new address";
  EXPECT_EQ(rig.on_disk().removed.at(0).address, 0x0100) << "used again after all others";
  rig.order(NodesOrder{});
  EXPECT_EQ(rig.answer().at(0)["robot"], "ble-0100");
  rig.order(RemoveOrder{"ble-0100", true});
  rig.pass(30s);
  EXPECT_TRUE(rig.on_disk().nodes.empty());
  EXPECT_EQ(rig.on_disk().removed.size(), 2u);
}

TEST(Provisioning, WarnsOnceOfTwoDevicesWithOneUuid) {
  ProvisioningRig rig;
  rig.add(1);
  rig.start();
  ASSERT_TRUE(rig.all_configured(20s));
  rig.board.devices.devices[0].address = 0;  // another device with this UUID, heard alone
  rig.pass(40s);
  ASSERT_EQ(rig.board.devices.devices[0].address, 0x0101);
  EXPECT_FALSE(rig.has_notice("two devices"));
  for (int i = 0; i < 2; ++i) rig.hear(0x0100, "cb 59 00 01 00 02 00");
  EXPECT_EQ(rig.count_notices("two devices have the UUID 736c616d010101010101010101010101"), 1);
}

TEST(Provisioning, ConfiguredNameFollowsResetRobot) {
  const RobotNames names({{"lego-1", 0x0100, {}}, {"lego-2", 0x0101, {}}});
  ProvisioningRig rig({}, test_database(), names);
  rig.add(1);
  rig.start();
  ASSERT_TRUE(rig.all_configured(20s));
  rig.board.devices.devices[0].address = 0;
  rig.pass(30s);
  EXPECT_EQ(rig.board.devices.devices[0].address, 0x0102) << "0x0101 is another robot's name";
  rig.hear(0x0102, "cb 59 00 01 00 02 00");
  EXPECT_EQ(rig.all<Report>().back().robot, "lego-1");
  // No other robot gets the name, and it survives a restart of the daemon.
  ProvisioningRig second({}, rig.on_disk(), names);
  second.board = rig.board;
  second.add(2);
  second.start();
  ASSERT_TRUE(second.all_configured(30s));
  EXPECT_EQ(second.board.devices.devices[1].address, 0x0101);
  second.hear(0x0102, "cb 59 00 01 00 02 00");
  EXPECT_EQ(second.all<Report>().back().robot, "lego-1");
  second.board.sent.clear();
  second.command("lego-1/cmd", hex("0a 00 ec ff"));
  second.run_for(100ms);
  EXPECT_FALSE(second.sent_to(0x0102).empty());
}

TEST(Provisioning, BeaconWithUuidOfNodeDoesNotChangeNode) {
  ProvisioningRig rig;
  rig.add(1);
  rig.start();
  ASSERT_TRUE(rig.all_configured(20s));
  const Bytes key = rig.board.devices.devices[0].device_key;
  rig.board.devices.devices[0].address = 0;
  for (int i = 0; i < 40; ++i) {  // the provisioning never completes
    rig.board.devices.fails_at = {0xc3, 1};
    rig.pass(1s);
  }
  const Node& node = rig.on_disk().nodes.at(0);
  EXPECT_EQ(node.address, 0x0100);
  EXPECT_EQ(node.new_address, 0x0101);
  EXPECT_EQ(node.state, NodeState::configured);
  EXPECT_EQ(to_hex(*node.device_key), to_hex(key));
}

/// The first of two joined nodes joins again with more elements than before, and the join fails.
void expect_neighbour_keeps_its_address(std::uint8_t elements, std::uint16_t first,
                                        const RobotNames& names) {
  ProvisioningRig rig({}, test_database(), names);
  rig.add(1);
  rig.add(2);
  rig.start();
  ASSERT_TRUE(rig.all_configured(30s));
  const auto second = static_cast<std::uint16_t>(first + 1);
  ASSERT_EQ(rig.board.devices.devices[1].address, second);
  FakeDevice& device = rig.board.devices.devices[0];
  device.address = 0;
  device.elements = elements;
  rig.board.devices.fails_at = {0xc5, 4};
  while (rig.board.devices.fails_at) rig.pass(1s);
  EXPECT_EQ(rig.on_disk().nodes.at(0).elements, 1) << "it still has its old address";
  rig.hear(second, "cb 59 00 01 00 02 00");
  EXPECT_EQ(rig.all<Report>().back().robot, names.of_ble(second));
  rig.pass(60s);
  EXPECT_TRUE(device.address != 0 && device.address != first);
  EXPECT_EQ(rig.on_disk().nodes.at(0).address, device.address);
  EXPECT_EQ(rig.on_disk().nodes.at(0).elements, elements);
  EXPECT_EQ(rig.on_disk().removed.at(0).elements, 1);
  for (const NodeDatabase& database : rig.stored)
    EXPECT_TRUE(decode_node_database(encode_node_database(database)).has_value());
}

TEST(Provisioning, NodeThatJoinsAgainWithMoreElementsDoesNotMoveItsNeighbour) {
  expect_neighbour_keeps_its_address(2, 0x0100, RobotNames());
  expect_neighbour_keeps_its_address(255, 0x0100, RobotNames());
  const RobotNames names({{"one", 0x0200, {}}, {"two", 0x0201, {}}});
  expect_neighbour_keeps_its_address(2, 0x0200, names);
}

TEST(Provisioning, ANodeThatJoinsAgainGetsAddressesForAllItsElements) {
  ProvisioningRig rig;
  rig.add(1).elements = 3;
  rig.start();
  ASSERT_TRUE(rig.all_configured(20s));
  rig.board.devices.devices[0].address = 0;
  rig.board.devices.fails_at = {0xc1, 1};  // before it says how many it has
  while (rig.board.devices.fails_at) rig.pass(1s);
  EXPECT_EQ(rig.on_disk().nodes.at(0).joining_elements(), 3);
  EXPECT_EQ(rig.on_disk().next_address, 0x0106);
  rig.pass(30s);
  EXPECT_EQ(rig.board.devices.devices[0].address, 0x0103);
}

/// A board whose replay list of 40 is full, of robots that were reset, and a robot that is not
/// heard.
struct FullReplayListRig : ProvisioningRig {
  FullReplayListRig() : ProvisioningRig({}, with_retired_addresses()) {
    board.forgets = true;
    add(1).deaf_to = {"80", "00"};
    start();
  }
  static NodeDatabase with_retired_addresses() {
    NodeDatabase database = test_database();
    for (int i = 0; i < 50; ++i) database.retire(static_cast<std::uint16_t>(0x0100 + i), 1, Uuid{});
    database.next_address = 0x0132;
    return database;
  }
};

TEST(Provisioning, RestartsBoardOnceForSilentRobotAtReusedAddress) {
  FullReplayListRig rig;
  rig.pass(120s);
  EXPECT_EQ(rig.board.count(0x0e), 1u) << "once, however long the robot stays silent";
  rig.board.devices.devices[0].deaf_to.clear();
  EXPECT_TRUE(rig.all_configured(400s));
  ProvisioningRig roomy;
  roomy.add(1).deaf_to = {"80", "00"};
  roomy.start();
  roomy.pass(120s);
  EXPECT_EQ(roomy.board.count(0x0e), 0u) << "the board's replay list has room";
}

/// A later loss of the link must not count as the restart.
void expect_an_order_ends_with_the_link(FullReplayListRig& rig) {
  rig.pass(120s);
  ASSERT_GE(rig.board.count(0x0e), 1u);
  ASSERT_EQ(rig.all<LinkChange>().size(), 1u) << "the link never went down";
  rig.order(RemoveOrder{"ble-0132"});
  rig.pass(1s);
  ASSERT_TRUE(rig.answer().is_null()) << rig.answer();
  rig.mesh.on_port_closed("unplugged", rig.now);
  rig.run_for(1ms);
  EXPECT_EQ(rig.answer(), "the BLE link went down: unplugged");
}

TEST(Provisioning, OrderFailsWithLinkAfterRefusedRestart) {
  FullReplayListRig rig;
  rig.board.status_of[0x0e] = 0x81;
  expect_an_order_ends_with_the_link(rig);
}

TEST(Provisioning, OrderFailsWithLinkAfterRestartWithoutEvent) {
  FullReplayListRig rig;
  rig.board.forgets = false;
  rig.spoil = [](Bytes& transfer) {
    if (transfer == hex("04 81 02 00 fe")) transfer.clear();
  };
  expect_an_order_ends_with_the_link(rig);
}

TEST(Provisioning, OrderContinuesAfterRestartOfBoard) {
  FullReplayListRig rig;
  while (rig.board.count(0x0e) == 0 && rig.now.time_since_epoch() < 120s) {
    if (rig.last_order == 0 || !rig.answer().is_null()) rig.order(ScanOrder{});
    rig.pass(100ms);
  }
  ASSERT_EQ(rig.board.count(0x0e), 1u);
  rig.pass(11s);
  EXPECT_TRUE(rig.answer().is_array()) << rig.answer();
}

TEST(Provisioning, RestartsBoardWhenLineIsSynchronisedAgain) {
  FullReplayListRig rig;
  bool is_spoilt = false;
  rig.spoil = [&](Bytes& bytes) {  // the board loses synchronisation right after the conversation
    const bool is_end = to_hex(bytes).starts_with("05849d00");
    if (is_end && !std::exchange(is_spoilt, true))
      std::ranges::copy(hex("03 84 00 84"), std::back_inserter(bytes));
  };
  while (!is_spoilt && rig.now.time_since_epoch() < 60s) rig.pass(100ms);
  ASSERT_TRUE(is_spoilt);
  rig.board.devices.devices[0].deaf_to.clear();
  rig.run_for(5s);
  EXPECT_EQ(rig.board.count(0x0e), 1u);
  EXPECT_TRUE(rig.all_configured(30s));
}

TEST(Provisioning, WarnsWhenBoardMayNotHearAllRobots) {
  NodeDatabase database = test_database();
  for (std::uint16_t i = 0; i < 40; ++i) {
    Node node;
    node.uuid.fill(static_cast<std::uint8_t>(i));
    node.address = static_cast<std::uint16_t>(0x0200 + i);
    node.state = NodeState::configured;
    database.nodes.push_back(node);
  }
  ProvisioningRig rig({}, database);
  rig.add(200);
  rig.start();
  rig.pass(10s);
  EXPECT_TRUE(rig.has_notice("ble-0100 may not be heard"));
}

TEST(Provisioning, DeviceThatLostItsReservationCanStillJoin) {
  NodeDatabase database = test_database();
  for (std::uint16_t i = 0; i < NodeDatabase::max_nodes; ++i) {
    Node node;
    node.uuid.fill(static_cast<std::uint8_t>(i));
    node.address = static_cast<std::uint16_t>(0x0200 + i);
    node.state = NodeState::configured;
    database.nodes.push_back(node);
  }
  database.nodes[0].uuid = *parse_uuid("736c616d010101010101010101010101");
  database.nodes[0].state = NodeState::reserved;
  ProvisioningRig full({}, database);
  full.add(2);
  full.start();
  full.pass(10s);
  EXPECT_NE(full.board.devices.devices[0].address, 0);
  full.order(RemoveOrder{"ble-0210", true});
  full.pass(60s);
  full.add(1);
  full.pass(20s);
  EXPECT_NE(full.board.devices.devices[1].address, 0);
}

TEST(Provisioning, GivesNewRobotsTheIvIndexOfTheMesh) {
  ProvisioningRig rig;
  rig.start();
  rig.say(hex("05 d3 07 00 00 00"));
  EXPECT_EQ(rig.on_disk().iv_index, 7u);
  rig.say(hex("05 d3 02 07 87 99"));  // as a serial line that lost octets has reported
  EXPECT_EQ(rig.on_disk().iv_index, 7u);
  rig.say(hex("05 d3 02 00 00 00"));
  EXPECT_EQ(rig.on_disk().iv_index, 7u);
  EXPECT_TRUE(rig.has_notice("IV index 2, which is lower than 7"));
  rig.add(1);
  EXPECT_TRUE(rig.all_configured(10s));
  EXPECT_EQ(rig.board.devices.last_iv_index, 7u);
  rig.say(hex("05 d3 02 00 00 00"));
  EXPECT_EQ(rig.on_disk().iv_index, 2u) << "it was reported twice";
}

TEST(Provisioning, ReportsWhenNoAddressIsLeft) {
  NodeDatabase database = test_database();
  database.next_address = 0x8000;
  for (std::uint32_t address = 0x0100; address < 0x8000; address += 255) {
    Node node;
    node.uuid[0] = static_cast<std::uint8_t>(address);
    node.uuid[1] = static_cast<std::uint8_t>(address >> 8);
    node.address = static_cast<std::uint16_t>(address);
    node.elements = static_cast<std::uint8_t>(std::min(255U, 0x8000U - address));
    node.state = NodeState::configured;
    database.nodes.push_back(node);
  }
  ProvisioningRig rig({}, database);
  rig.add(1);
  rig.start();
  rig.pass(10s);
  EXPECT_TRUE(rig.has_notice("no unicast address is left"));
  EXPECT_EQ(rig.board.count(0x63), 0u);
}

TEST(Provisioning, NeverShowsAKey) {
  ProvisioningRig rig;
  rig.add(1).refuses["80"] = 5;
  rig.start();
  rig.pass(20s);
  rig.order(NodesOrder{});
  const std::string key = to_hex(rig.board.devices.devices[0].device_key);
  for (const std::string& secret : {key, std::string(32, '1'), std::string(32, '2')}) {
    EXPECT_FALSE(rig.has_notice(secret));
    EXPECT_EQ(rig.answers.back().json.find(secret), std::string::npos);
  }
}

}  // namespace
}  // namespace slamgw::ble
