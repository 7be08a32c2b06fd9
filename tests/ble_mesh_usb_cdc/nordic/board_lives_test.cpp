// SPDX-License-Identifier: Apache-2.0
// Boards that forget their sequence numbers, seen through BleMesh. Robots drop messages from an
// address with numbers that they have heard. So each life of the board sends from another address.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include "adapters/ble_mesh_usb_cdc/provisioning/mesh_json.hpp"
#include "tests/ble_mesh_usb_cdc/provisioning_rig.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;

NodeDatabase robot_database(std::uint16_t address = first_robot) {
  NodeDatabase database = test_database();
  Node node;
  node.uuid.fill(5);
  node.address = address;
  node.state = NodeState::configured;
  database.nodes.push_back(node);
  return database;
}

struct LivesRig : ProvisioningRig {
  explicit LivesRig(std::optional<NodeDatabase> database = test_database(), Settings settings = {},
                    RobotNames names = RobotNames())
      : ProvisioningRig(std::move(settings), std::move(database), std::move(names)) {
    board.forgets = true;
  }
  std::string detail() const { return all<LinkChange>().back().detail; }
};

TEST(BoardLives, BeginAtTheGatewaysOwnAddress) {
  LivesRig rig(std::nullopt);
  rig.start();
  EXPECT_EQ(rig.board.unicast, 0x0001);
  EXPECT_EQ(rig.board.unicast_count, max_sources)
      << "all addresses that robots may still publish to";
  EXPECT_EQ(rig.source_of_an_answer(), 0x0001);
  EXPECT_EQ(rig.on_disk().life.number, 1u);
  EXPECT_NE(rig.detail().find("sends from 0x0001 (life 1)"), std::string::npos) << rig.detail();
}

TEST(BoardLives, SendFromTheNextAddressWhenTheBoardForgot) {
  LivesRig rig;
  rig.start();
  for (std::uint16_t life = 2; life <= 5; ++life) {
    rig.power_cycle_board();
    EXPECT_TRUE(rig.is_up());
    EXPECT_EQ(rig.board.unicast, 0x0001) << "robots still publish to it";
    EXPECT_EQ(rig.board.unicast_count, max_sources);
    EXPECT_EQ(rig.source_of_an_answer(), life);
  }
  EXPECT_NE(rig.detail().find("forgets at power-off, sends from 0x0005 (life 5)"),
            std::string::npos)
      << rig.detail();
  EXPECT_EQ(rig.counter("source_address"), 5u);
  EXPECT_EQ(rig.counter("board_lives"), 5u);
}

TEST(BoardLives, AreOnDiskBeforeTheirAddressIsUsed) {
  LivesRig rig;
  rig.start();
  rig.stored.clear();
  rig.answers_stores = false;
  rig.board.commands.clear();
  rig.power_cycle_board();
  ASSERT_EQ(rig.stored.size(), 1u);
  EXPECT_EQ(rig.stored[0].life.source, 0x0002);
  EXPECT_EQ(rig.board.count(0x9f), 0u) << "not before the disk has it";
  EXPECT_FALSE(rig.is_up());
  rig.mesh.on_stored("disk full", rig.now);
  rig.run_for(1ms);
  EXPECT_NE(rig.detail().find("disk full"), std::string::npos) << rig.detail();
  rig.answers_stores = true;
  rig.run_for(10s);
  EXPECT_TRUE(rig.is_up());
  EXPECT_EQ(rig.source_of_an_answer(), 0x0002);
}

TEST(BoardLives, RestartsWhileDiskIsSlowBeginOneLife) {
  LivesRig rig;
  rig.start();
  rig.answers_stores = false;
  rig.power_cycle_board();
  rig.power_cycle_board();
  rig.mesh.on_port_closed("unplugged", rig.now);
  rig.answers_stores = true;
  rig.mesh.on_stored({}, rig.now);
  rig.open();
  rig.run_for(2s);
  EXPECT_TRUE(rig.is_up());
  EXPECT_EQ(rig.source_of_an_answer(), 0x0002);
}

TEST(BoardLives, ContinueAfterDaemonRestart) {
  LivesRig first;
  first.start();
  first.power_cycle_board();
  const auto on_disk = decode_node_database(encode_node_database(first.on_disk()));
  ASSERT_TRUE(on_disk.has_value());
  LivesRig second(*on_disk);
  second.board = first.board;
  second.start();
  EXPECT_EQ(second.source_of_an_answer(), 0x0002) << "the board still has it";
  EXPECT_TRUE(second.stored.empty());
  EXPECT_NE(second.detail().find("forgets at power-off"), std::string::npos) << second.detail();
  second.power_cycle_board();
  EXPECT_EQ(second.source_of_an_answer(), 0x0003);
}

TEST(BoardLives, TreatFileWithoutLivesAsFirstLife) {
  const auto old = decode_node_database(
      R"({"version": 2, "net_key": "11111111111111111111111111111111",
          "app_key": "22222222222222222222222222222222", "iv_index": 0, "next_address": "0x0100",
          "nodes": [], "removed": []})");
  ASSERT_TRUE(old.has_value());
  LivesRig rig(*old);
  rig.start();
  EXPECT_EQ(rig.source_of_an_answer(), 0x0002);
  EXPECT_EQ(rig.on_disk().life.number, 2u);
}

TEST(BoardLives, ABoardThatKeepsItsNumbersKeepsItsAddress) {
  LivesRig rig;
  rig.board.forgets = false;
  rig.start();
  rig.power_cycle_board();
  rig.power_cycle_board();
  EXPECT_EQ(rig.source_of_an_answer(), 0x0001);
  EXPECT_NE(rig.detail().find("keeps its address at power-off, sends from 0x0001 (life 1)"),
            std::string::npos)
      << rig.detail();
}

TEST(BoardLives, AnotherBoardBeginsAnotherLife) {
  LivesRig rig;
  rig.board.forgets = false;
  rig.start();
  rig.mesh.on_port_closed("unplugged", rig.now);
  const FakeBoard kept = std::exchange(rig.board, FakeBoard{});
  rig.board.uuid_octet = 0xcd;
  rig.open();
  rig.run_for(1s);
  EXPECT_EQ(rig.source_of_an_answer(), 0x0002);
  rig.mesh.on_port_closed("unplugged", rig.now);
  rig.board = kept;
  rig.open();
  rig.run_for(1s);
  EXPECT_EQ(rig.source_of_an_answer(), 0x0003) << "its numbers may be lower than at 0x0001 before";
}

TEST(BoardLives, BoardConfiguredByEarlierVersionKeepsItsAddress) {
  LivesRig rig(robot_database());
  rig.initial.life.number = 1;
  rig.board.unicast = 0x0001;
  rig.board.subnets = {{std::uint16_t{0}, Bytes(16, 0x11)}};
  rig.board.appkeys = {{std::uint16_t{0}, Bytes(16, 0x22)}};
  rig.start();
  EXPECT_EQ(rig.source_of_an_answer(), 0x0001);
  rig.power_cycle_board();
  EXPECT_EQ(rig.source_of_an_answer(), 0x0002);
}

/// The board acknowledges the segments of a message from the address that it was sent to.
TEST(BoardLives, MovePublicationsOfRobotsToNewAddress) {
  LivesRig rig;
  for (std::uint8_t number = 1; number <= 10; ++number) rig.add(number);
  rig.start();
  ASSERT_TRUE(rig.all_configured(60s));
  for (FakeDevice& device : rig.board.devices.devices) device.requests.clear();
  rig.power_cycle_board();
  rig.run_for(4s);
  for (const Node& node : rig.on_disk().nodes) EXPECT_EQ(node.applied->destination, 0x0002);
  for (const FakeDevice& device : rig.board.devices.devices) {
    EXPECT_EQ(device.requests.size(), 4u) << "the composition data and three publications";
    for (const std::string& request : device.requests)
      EXPECT_TRUE(request == "800800" ||
                  (request.starts_with("03") && request.substr(6, 4) == "0200"))
          << request;
  }
}

TEST(BoardLives, LeavePublicationsToGroupUnchanged) {
  Settings settings;
  settings.gateway_group = 0xc010;
  LivesRig rig(test_database(), settings);
  rig.add(1);
  rig.start();
  ASSERT_TRUE(rig.all_configured(30s));
  rig.board.devices.devices[0].requests.clear();
  rig.power_cycle_board();
  rig.run_for(10s);
  EXPECT_TRUE(rig.board.devices.devices[0].requests.empty());
}

TEST(BoardLives, MovePublicationsOfAbsentRobotWhenItIsHeard) {
  LivesRig rig;
  rig.add(1);
  rig.start();
  ASSERT_TRUE(rig.all_configured(30s));
  rig.board.devices.devices[0].deaf_to = {"80", "03"};
  rig.power_cycle_board();
  rig.run_for(200s);
  EXPECT_EQ(rig.on_disk().nodes.at(0).applied->destination, 0x0001);
  rig.board.devices.devices[0].deaf_to.clear();
  rig.hear(first_robot, "cb 59 00 0a 00 ec ff");
  rig.run_for(25s);
  EXPECT_EQ(rig.on_disk().nodes.at(0).applied->destination, 0x0002);
}

TEST(BoardLives, ClearedBoardBeginsAnotherLife) {
  LivesRig rig;
  rig.board.forgets = false;
  rig.start();
  rig.order(ResetBoardOrder{});
  rig.run_for(2s);
  EXPECT_EQ(rig.source_of_an_answer(), 0x0002);
  EXPECT_EQ(rig.detail().find("forgets"), std::string::npos) << rig.detail();
}

TEST(BoardLives, ReuseFirstAddressAfterLastAndWarn) {
  LivesRig rig;
  rig.start();
  for (int life = 2; life <= max_sources; ++life) rig.power_cycle_board();
  EXPECT_EQ(rig.source_of_an_answer(), max_sources);
  EXPECT_EQ(rig.count_notices("used up"), 0);
  EXPECT_EQ(rig.counter("source_reused"), 0u);
  rig.power_cycle_board();
  EXPECT_EQ(rig.source_of_an_answer(), 0x0001);
  EXPECT_EQ(rig.count_notices("used up after life 32"), 1);
  EXPECT_TRUE(rig.has_notice("switch robots that do not obey off and on"));
  EXPECT_EQ(rig.counter("source_reused"), 1u);
  rig.power_cycle_board();
  EXPECT_EQ(rig.source_of_an_answer(), 0x0002);
}

TEST(BoardLives, EndBeforeAddressesOfNodesRobotsAndOtherGateways) {
  LivesRig node(robot_database(0x0004));
  node.start();
  for (int life = 2; life <= 4; ++life) node.power_cycle_board();
  EXPECT_EQ(node.source_of_an_answer(), 0x0001);
  LivesRig named(test_database(), {}, RobotNames({{"r1", 0x0003, {}}}));
  named.start();
  for (int life = 2; life <= 3; ++life) named.power_cycle_board();
  EXPECT_EQ(named.source_of_an_answer(), 0x0001);
  NodeDatabase shared = test_database();
  shared.gateways = {0x0002};
  LivesRig host(shared);
  host.start();
  host.power_cycle_board();
  EXPECT_EQ(host.source_of_an_answer(), 0x0001);
  EXPECT_TRUE(host.has_notice("used up"));
}

/// A device with the mesh's keys, or octets lost on the serial line, can forge an address.
TEST(BoardLives, AreNotEndedByOneMessageFromForgedAddress) {
  LivesRig rig;
  rig.start();
  rig.hear(0x0002, update_set);
  rig.power_cycle_board();
  EXPECT_EQ(rig.source_of_an_answer(), 0x0002);
  EXPECT_FALSE(rig.has_notice("used up"));
  for (int i = 0; i < 3; ++i) rig.hear(0x0003, update_set);  // another tool's robot
  rig.power_cycle_board();
  EXPECT_EQ(rig.source_of_an_answer(), 0x0001);
}

TEST(BoardLives, EndBeforeAnotherToolsRobotDespiteManyForgedAddresses) {
  LivesRig rig;
  rig.start();
  for (std::uint16_t address = 0x1000; address < 0x1000 + NodeDatabase::max_nodes; ++address)
    rig.hear(address, "cb 59 00 01 00 02 00");
  rig.run_for(60s);  // long enough for other robots to replace them
  for (int i = 0; i < 3; ++i) rig.hear(0x0002, update_set);
  rig.power_cycle_board();
  EXPECT_EQ(rig.source_of_an_answer(), 0x0001);
}

TEST(BoardLives, MessagesFromTheirAddressesAreRejected) {
  LivesRig rig;
  rig.start();
  rig.power_cycle_board();
  rig.events.clear();
  for (const std::uint16_t own : std::initializer_list<std::uint16_t>{0x0001, 0x0002}) {
    rig.hear(own, update_set);
    rig.say(hex(fmt::format("07 d8 08 02 03 00 {:02x} 00", own)));  // a heartbeat
  }
  EXPECT_TRUE(rig.all<Report>().empty());
  EXPECT_TRUE(rig.all<PresenceChange>().empty());
  EXPECT_EQ(rig.counter("rejected"), 2u);
  EXPECT_TRUE(rig.has_notice("the last from 0x0001: its source is an address of this gateway"));
  rig.hear(0x0003, update_set);
  EXPECT_EQ(rig.all<Report>().size(), 1u)
      << "not used by a life yet, so it is another tool's robot";
}

TEST(BoardLives, NodeAndNamedRobotKeepTheirAddresses) {
  NodeDatabase database = robot_database(0x0003);
  database.life = {.number = 9, .source = 0x0009};
  LivesRig rig(database, {}, RobotNames({{"r1", 0x0004, {}}}));
  rig.start();
  rig.hear(0x0003, update_set);
  rig.hear(0x0004, update_set);
  EXPECT_EQ(rig.all<Report>().size(), 2u);
}

TEST(BoardLives, GatewaysGetDisjointAddresses) {
  LivesRig host;
  host.start();
  std::set<std::uint16_t> taken;
  for (int i = 0; i < 7; ++i) {
    host.order(ExportOrder{});
    const auto exported = decode_node_database(host.answer()["mesh"].get<std::string>());
    ASSERT_TRUE(exported.has_value());
    EXPECT_EQ(exported->life.number, 0u) << "no robot has heard the new gateway";
    for (std::uint32_t k = 0; k < exported->guest_addresses; ++k) {
      const auto address = static_cast<std::uint16_t>(*exported->guest_address + k);
      EXPECT_TRUE(taken.insert(address).second) << address;
      EXPECT_TRUE(address > max_sources && address < 0x0100) << address;
    }
  }
  EXPECT_EQ(taken.size(), 0xffu - max_sources);
  host.order(ExportOrder{});
  EXPECT_TRUE(host.answer().is_string()) << "all addresses are assigned";
}

TEST(BoardLives, GuestGatewayUsesOnlyItsAssignedAddresses) {
  NodeDatabase given = robot_database();
  given.guest_address = 0x0021;
  given.guest_addresses = 2;
  Settings settings;
  settings.address = 0x0021;
  LivesRig guest(given, settings);
  guest.start();
  EXPECT_EQ(guest.source_of_an_answer(), 0x0021);
  guest.power_cycle_board();
  EXPECT_EQ(guest.source_of_an_answer(), 0x0022);
  guest.power_cycle_board();
  EXPECT_EQ(guest.source_of_an_answer(), 0x0021);
}

TEST(BoardLives, RobotsGetNoneOfTheirAddresses) {
  Settings settings;
  settings.address = 0x0100;
  LivesRig rig(test_database(), settings);
  rig.add(1);
  rig.start();
  ASSERT_TRUE(rig.all_configured(30s));
  EXPECT_EQ(rig.on_disk().nodes.at(0).address, 0x0100 + max_sources);
}

/// Restarts the board while its port stays open, without its event 81.
void reset_unseen(LivesRig& rig) { rig.board.restart(); }

/// A board that was built with storage keeps its address, so nothing shows that it has restarted.
TEST(BoardThatRestartedUnseen, ScansAgain) {
  LivesRig rig;
  rig.board.forgets = false;
  rig.start();
  reset_unseen(rig);
  rig.say(hex("00"));  // the rest of its start event
  rig.run_for(2s);
  rig.add(1);
  EXPECT_TRUE(rig.all_configured(30s));
}

TEST(BoardThatRestartedUnseen, IsConfiguredAgainWhenItRefusesSend) {
  LivesRig rig;
  rig.start();
  EXPECT_EQ(rig.source_of_an_answer(), 0x0001);
  reset_unseen(rig);
  for (int asked = 0; asked < 2; ++asked) {  // the first is refused for its handle
    rig.hear(first_robot, "ca 59 00");
    rig.run_for(500ms);
  }
  EXPECT_TRUE(rig.is_up());
  EXPECT_EQ(rig.source_of_an_answer(), 0x0002);
  EXPECT_EQ(rig.counter("board_restarts"), 1u);
  rig.run_for(3s);
  reset_unseen(rig);
  for (int asked = 0; asked < 2; ++asked) {
    rig.hear(first_robot, "ca 59 00");
    rig.run_for(500ms);
  }
  EXPECT_EQ(rig.source_of_an_answer(), 0x0003) << "at once the second time, too";
}

TEST(BoardThatRestartedUnseen, IsConfiguredAgainWhenPollShowsIt) {
  LivesRig rig;
  rig.start();
  reset_unseen(rig);
  rig.run_for(22s);
  EXPECT_TRUE(rig.is_up());
  EXPECT_NE(rig.board.unicast, 0);
  EXPECT_EQ(rig.source_of_an_answer(), 0x0002);
  const auto changes = rig.all<LinkChange>();
  EXPECT_TRUE(std::ranges::any_of(changes, [](const LinkChange& change) {
    return change.detail == "the serial board restarted without a start event";
  }));
}

TEST(BoardThatRestartedUnseen, IsNotAssumedAfterOtherRefusals) {
  LivesRig rig;
  rig.start();
  const std::size_t starts = rig.board.count(0x09);
  for (const std::uint8_t status : hex("80 81 83 84 85 86 8e 93")) {
    rig.board.status_of[0xab] = status;
    rig.hear(first_robot, "ca 59 00");
    rig.run_for(500ms);
  }
  EXPECT_EQ(rig.board.count(0x09), starts);
  EXPECT_TRUE(rig.is_up());
}

TEST(BoardThatRestartedUnseen, IsCheckedOnceIn30SecondsWhileItRefusesSends) {
  LivesRig rig;
  rig.start();
  const std::size_t starts = rig.board.count(0x09);
  rig.board.status_of[0xab] = 0x87;
  for (int second = 0; second < 60; ++second) {
    rig.hear(first_robot, "ca 59 00");
    rig.run_for(1s);
  }
  EXPECT_EQ(rig.board.count(0x09), starts + 2);
  EXPECT_TRUE(rig.is_up()) << "the board still has its address";
  EXPECT_EQ(rig.on_disk().life.number, 1u);
}

/// Lets robots send a message and repeat it after each answer, as deaf robots do.
void repeat_all(LivesRig& rig, std::string_view set, int copies = 7) {
  Duration gap = 280ms;
  for (int copy = 0; copy < copies; ++copy) {
    for (std::uint16_t robot = 0x0201; robot <= 0x0203; ++robot) {
      rig.hear(robot, set);
      rig.receipt(rig.all<Report>().back().receipt.id);
    }
    rig.run_for(gap);
    if (copy > 0) gap *= 2;
  }
}

TEST(BoardLives, AnotherLifeIsTriedOnceWhenRobotsHearNothing) {
  LivesRig rig;
  rig.start();
  rig.power_cycle_board();
  EXPECT_EQ(rig.counter("board_lives"), 2u);
  repeat_all(rig, "c5 59 00 01");
  EXPECT_EQ(rig.count_notices("to send from another address"), 1);
  EXPECT_EQ(rig.counter("board_lives"), 3u);
  EXPECT_TRUE(rig.is_up());
  EXPECT_EQ(rig.source_of_an_answer(), 0x0003);
  repeat_all(rig, "c5 59 00 02");
  EXPECT_EQ(rig.count_notices("switch them off and on"), 1) << "the new address did not help";
  EXPECT_EQ(rig.counter("mostly_deaf"), 1u);
  EXPECT_EQ(rig.counter("board_lives"), 3u);
  rig.power_cycle_board();
  repeat_all(rig, "c5 59 00 03");
  EXPECT_EQ(rig.counter("board_lives"), 5u) << "each life may try another address once";
}

/// Nordic's robots double the time between copies, so one comes long after the new life began.
TEST(BoardLives, RepeatFromPreviousLifeDoesNotMakeRobotDeaf) {
  LivesRig rig;
  rig.start();
  rig.power_cycle_board();
  repeat_all(rig, "c5 59 00 01");
  ASSERT_EQ(rig.counter("board_lives"), 3u);
  for (std::uint16_t robot = 0x0201; robot <= 0x0203; ++robot) rig.hear(robot, "c5 59 00 01");
  rig.run_for(1s);
  EXPECT_EQ(rig.counter("mostly_deaf"), 0u);
  EXPECT_EQ(rig.count_notices("switch them off and on"), 0);
}

TEST(BoardLives, NoOtherLifeIsTriedWhenRobotsBecomeDeafLater) {
  LivesRig rig;
  rig.start();
  rig.run_for(BleMesh::address_suspected_for);
  repeat_all(rig, "c5 59 00 01");
  EXPECT_EQ(rig.counter("board_lives"), 1u);
  EXPECT_EQ(rig.count_notices("switch them off and on"), 1);
}

TEST(BoardLives, NoOtherLifeIsTriedWithBoardThatKeepsItsAddress) {
  LivesRig rig;
  rig.board.forgets = false;
  rig.start();
  rig.power_cycle_board();
  repeat_all(rig, "c5 59 00 01");
  EXPECT_EQ(rig.board.count(0x0e), 0u);
  EXPECT_EQ(rig.count_notices("switch them off and on"), 1);
}

TEST(BoardLives, LostRestartCommandIsRepeated) {
  LivesRig rig;
  rig.start();
  bool is_lost = false;
  rig.spoil = [&](Bytes& transfer) {
    if (is_lost || transfer != hex("01 0e")) return;
    transfer.clear();
    is_lost = true;
  };
  repeat_all(rig, "c5 59 00 01");
  rig.run_for(10s);
  EXPECT_TRUE(is_lost);
  EXPECT_EQ(rig.board.count(0x0e), 1u);
  EXPECT_EQ(rig.source_of_an_answer(), 0x0002);
}

/// A board with storage keeps its address, so nothing shows its restart.
TEST(BoardLives, BoardWithoutStartEventIsRestartedTwiceAtMost) {
  LivesRig rig;
  rig.board.forgets = false;
  rig.start();
  rig.spoil = [](Bytes& transfer) {
    if (transfer == hex("04 81 02 00 fe")) transfer.clear();
  };
  repeat_all(rig, "c5 59 00 01");
  rig.run_for(30s);
  EXPECT_EQ(rig.board.count(0x0e), 2u);
  EXPECT_TRUE(rig.is_up());
  EXPECT_EQ(rig.count_notices("not Nordic's"), 0);
  EXPECT_EQ(rig.all<LinkChange>().size(), 1u) << "the link never went down";
}

TEST(BoardLives, AnotherLifeWaitsUntilDeviceHasJoined) {
  LivesRig rig;
  rig.start();
  repeat_all(rig, "c5 59 00 01");
  ASSERT_EQ(rig.board.count(0x0e), 1u);
  LivesRig joining;
  joining.start();
  joining.say(hex("02 c1 00"));
  repeat_all(joining, "c5 59 00 01", 6);
  EXPECT_EQ(joining.count_notices("to send from another address"), 1);
  EXPECT_EQ(joining.board.count(0x0e), 0u);
  joining.say(hex("03 c2 00 02"));
  joining.run_for(1s);
  EXPECT_EQ(joining.board.count(0x0e), 1u);
}

TEST(BoardLives, AreCountedBeforeThereIsAMesh) {
  const BleMesh mesh({}, TopicScheme("ntnu-slam", "pi1"), RobotNames(), std::nullopt,
                     std::make_unique<BoardRadio>(Settings{}, std::nullopt, RandomSource{}, 1), {});
  const Counters counters = mesh.counters();
  const auto reused = std::ranges::find(counters, "source_reused", &Counter::name);
  ASSERT_NE(reused, counters.end());
  EXPECT_EQ(reused->value, 0u);
}

}  // namespace
}  // namespace slamgw::ble
