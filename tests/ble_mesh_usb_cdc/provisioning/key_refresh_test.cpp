// SPDX-License-Identifier: Apache-2.0
// The refresh of the mesh's keys: each step, robots that it waits for or leaves behind, and that
// it continues wherever it was interrupted.
#include <gtest/gtest.h>

#include "adapters/ble_mesh_usb_cdc/provisioning/mesh_json.hpp"
#include "tests/ble_mesh_usb_cdc/provisioning_rig.hpp"
#include "tests/support/transcript.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;

constexpr std::size_t mesh_size = 4;
constexpr const char* net_key_update = "8045";
constexpr const char* switch_over = "8016000002";
constexpr const char* finish = "8016000003";

Bytes octets(const Key& key) { return {key.begin(), key.end()}; }

bool has_new_keys(const FakeDevice& device) {
  return device.refresh_phase == 0 && device.net_key == octets(new_keys().net_key) &&
         device.app_key == octets(new_keys().app_key);
}

bool has_old_keys(const FakeDevice& device) {
  return device.refresh_phase == 0 && device.net_key == octets(test_keys().net_key);
}

/// A snapshot of the board and the disk.
struct Moment {
  FakeBoard board;
  NodeDatabase database;
};

struct RefreshRig : ProvisioningRig {
  explicit RefreshRig(std::size_t robots = mesh_size) {
    for (std::size_t i = 1; i <= robots; ++i) add(static_cast<std::uint8_t>(i));
    start();
    if (!all_configured(60s)) ADD_FAILURE() << "not all robots have joined";
  }
  /// Starts the next daemon.
  explicit RefreshRig(const Moment& moment) : ProvisioningRig({}, moment.database) {
    board = moment.board;
    start();
  }
  FakeDevice& device(std::size_t i = 0) { return board.devices.devices[i]; }

  nlohmann::json refresh(RefreshKeysOrder what = {}) {
    order(std::move(what));
    return answer();
  }
  nlohmann::json status() { return refresh({.is_question = true}); }
  std::string step() { return status()["step"]; }
  std::string missing_robot() {
    const nlohmann::json missing = status()["missing"];
    return missing.size() == 1 ? missing[0]["robot"].get<std::string>() : missing.dump();
  }
  bool reaches(const std::string& wanted, Duration limit = 60s) {
    for (const TimePoint end = now + limit; now < end; pass(100ms))
      if (step() == wanted) return true;
    return false;
  }
  bool is_complete() const {
    const auto& devices = board.devices.devices;
    return std::ranges::all_of(devices, has_new_keys) && on_disk().keys == new_keys() &&
           !on_disk().refresh && board.subnets.front().second == octets(new_keys().net_key) &&
           board.appkeys.front().second == octets(new_keys().app_key) && board.new_net_key.empty();
  }
  std::size_t said(std::string_view request) const {
    return static_cast<std::size_t>(std::ranges::count_if(board.sent, [&](const auto& packet) {
      return to_hex(packet.payload).starts_with(request);
    }));
  }
};

TEST(KeyRefresh, GivesAllRobotsNewKeys) {
  RefreshRig rig;
  const nlohmann::json begun = rig.refresh();
  EXPECT_EQ(begun["step"], "distributing") << begun;
  EXPECT_EQ(begun["robots"], mesh_size);
  EXPECT_EQ(begun["missing"].size(), mesh_size);
  ASSERT_TRUE(rig.reaches("none"));
  EXPECT_TRUE(rig.is_complete());
  EXPECT_TRUE(rig.is_up());
  EXPECT_EQ(rig.source_of_an_answer(), 0x0002) << "robots know the old address with high numbers";
  rig.pass(10s);
  for (const Node& node : rig.on_disk().nodes) EXPECT_EQ(node.applied->destination, 0x0002);
  EXPECT_TRUE(rig.has_notice("are refreshed: 4 robots have the new ones"));
}

/// A stock board drops some of its answers to the 255 zeros that synchronise it.
TEST(KeyRefresh, DoesNotBlameTheSerialLineForAnswersToItsOwnZeros) {
  RefreshRig rig(1);
  rig.spoil = [&](Bytes& written) {
    if (written == Bytes(255, 0)) rig.board.dropped += 120;
  };
  rig.refresh();
  ASSERT_TRUE(rig.reaches("none"));
  rig.pass(60s);
  EXPECT_EQ(rig.count_notices("too slow for this mesh"), 0);
  EXPECT_EQ(rig.counter("board_drops"), 0u);
  rig.board.dropped += 3;
  rig.pass(30s);
  EXPECT_EQ(rig.count_notices("dropped 3 event(s)"), 1);
}

TEST(KeyRefresh, SendsNothingBeforeItIsOnDisk) {
  RefreshRig rig(1);
  rig.answers_stores = false;
  EXPECT_TRUE(rig.refresh().is_null());
  rig.pass(10s);
  EXPECT_EQ(rig.stored.back().refresh->other, new_keys());
  EXPECT_EQ(rig.said(net_key_update), 0u);
  rig.pass(15s);
  EXPECT_NE(rig.answer().dump().find("it takes longer"), std::string::npos) << rig.answer();
}

TEST(KeyRefresh, EndsAtOnceWhenNoKeysCanBeMade) {
  RefreshRig rig(1);
  rig.has_randomness = false;
  EXPECT_EQ(rig.refresh(), "no randomness for the mesh's keys");
  EXPECT_TRUE(rig.has_notice("no randomness for the mesh's keys"));
  EXPECT_EQ(rig.step(), "none");
  rig.has_randomness = true;
  EXPECT_EQ(rig.refresh()["step"], "distributing");
}

TEST(KeyRefresh, OrderedTwiceBeforeItIsOnDiskBeginsOnce) {
  RefreshRig rig(2);
  rig.answers_stores = false;
  rig.refresh();
  rig.pass(21s);
  EXPECT_NE(rig.answer().dump().find("it takes longer"), std::string::npos) << rig.answer();
  rig.order(ExportOrder{});
  EXPECT_NE(rig.answer().dump().find("are being refreshed"), std::string::npos) << rig.answer();
  rig.order(MeasureHearingOrder{});
  EXPECT_NE(rig.answer().dump().find("are being refreshed"), std::string::npos) << rig.answer();
  EXPECT_TRUE(rig.refresh().is_null());
  EXPECT_EQ(rig.keys_drawn, 2);
  rig.answers_stores = true;
  rig.mesh.on_stored({}, rig.now);
  rig.run_for(1ms);
  EXPECT_EQ(rig.answer()["step"], "distributing") << rig.answer();
  ASSERT_TRUE(rig.reaches("none"));
  EXPECT_TRUE(rig.is_complete());
  EXPECT_EQ(rig.on_disk().nodes.size(), 2u);
}

TEST(KeyRefresh, BeginsEachStepWhenItIsOnDisk) {
  RefreshRig rig(1);
  const auto hold = [&](RefreshStep step) {
    rig.answers_stores = true;
    for (int i = 0; i < 2000 && rig.stored.back().refresh->step != step; ++i) {
      const std::size_t before = rig.stored.size();
      rig.answers_stores = false;
      rig.run_for(10ms);
      if (rig.stored.size() == before || rig.stored.back().refresh->step == step) continue;
      rig.mesh.on_stored({}, rig.now);
    }
    rig.pass(5s);
    return rig.stored.back().refresh->step == step;
  };
  rig.refresh();
  ASSERT_TRUE(hold(RefreshStep::switching));
  EXPECT_EQ(rig.board.count(0x93), 0u);
  EXPECT_EQ(rig.said("8016"), 0u);
  rig.mesh.on_stored({}, rig.now);
  ASSERT_TRUE(hold(RefreshStep::finishing));
  EXPECT_EQ(rig.board.count(0x93), 1u);
  EXPECT_EQ(rig.board.count(0xac), 0u);
  EXPECT_EQ(rig.said(finish), 0u);
  EXPECT_EQ(rig.device().refresh_phase, 2);
}

TEST(KeyRefresh, HearsRobotsAtEachStep) {
  RefreshRig rig;
  rig.device(3).deaf_to = {switch_over};
  rig.refresh();
  ASSERT_TRUE(rig.reaches("switching"));
  rig.pass(2s);
  EXPECT_EQ(rig.device(0).refresh_phase, 2);
  EXPECT_EQ(rig.board.new_net_key, octets(new_keys().net_key)) << "the board hears both";
  EXPECT_TRUE(rig.is_up());
  EXPECT_EQ(std::ranges::count(rig.all<LinkChange>(), false, &LinkChange::is_up), 0);
}

TEST(KeyRefresh, WaitsForASilentRobot) {
  RefreshRig rig;
  rig.device(2).deaf_to = {net_key_update};
  rig.refresh();
  rig.pass(120s);
  EXPECT_EQ(rig.step(), "distributing");
  EXPECT_EQ(rig.missing_robot(), "ble-0102");
  EXPECT_EQ(rig.status()["missing"][0]["problem"], "no answer to the new network key in 20 s");
  EXPECT_EQ(rig.status()["missing"][0]["has_new_keys"], false);
  EXPECT_TRUE(rig.has_notice("ble-0102 has not completed the key refresh yet"));
  EXPECT_EQ(rig.counter("key_refresh_step"), 1u);
  EXPECT_EQ(rig.counter("key_refresh_missing"), 1u);
  EXPECT_EQ(rig.board.count(0x93), 0u) << "the other robots still use the old keys";
  rig.device(2).deaf_to.clear();
  rig.hear(0x0102, "cb 59 00 01 00 02 00");
  ASSERT_TRUE(rig.reaches("none"));
  EXPECT_TRUE(rig.is_complete());
}

TEST(KeyRefresh, ReportsRefusalAndTriesAgain) {
  RefreshRig rig;
  rig.device(1).refuses = {{"01", 0x05}};
  rig.refresh();
  rig.pass(30s);
  EXPECT_EQ(rig.missing_robot(), "ble-0101");
  EXPECT_EQ(rig.status()["missing"][0]["problem"],
            "the new application key was refused: insufficient resources (0x05)");
  rig.device(1).refuses.clear();
  ASSERT_TRUE(rig.reaches("none", 300s));
  EXPECT_TRUE(rig.is_complete());
}

TEST(KeyRefresh, IgnoresStatusOfAnotherPhase) {
  RefreshRig rig;
  rig.device(0).lies = {{switch_over, "80 17 00 00 00 01"}, {finish, "80 17 00 00 00 02"}};
  rig.refresh();
  ASSERT_TRUE(rig.reaches("finishing"));
  rig.pass(60s);
  EXPECT_EQ(rig.step(), "finishing");
  EXPECT_EQ(rig.missing_robot(), "ble-0100");
  rig.device(0).lies.clear();
  ASSERT_TRUE(rig.reaches("none", 300s));
  EXPECT_TRUE(rig.is_complete());
}

TEST(KeyRefresh, SilentRobotWithNewKeysDelaysNoOther) {
  RefreshRig rig;
  rig.device(3).deaf_to = {"8016"};
  rig.refresh();
  ASSERT_TRUE(rig.reaches("finishing"));
  rig.pass(30s);
  EXPECT_EQ(rig.missing_robot(), "ble-0103");
  EXPECT_EQ(rig.status()["missing"][0]["has_new_keys"], true);
  for (std::size_t i = 0; i < 3; ++i) EXPECT_TRUE(has_new_keys(rig.device(i))) << i;
  EXPECT_EQ(rig.board.subnets.front().second, octets(new_keys().net_key));
  rig.device(3).deaf_to.clear();
  ASSERT_TRUE(rig.reaches("none", 300s));
  EXPECT_TRUE(rig.is_complete());
}

TEST(KeyRefresh, LeavesNamedRobotBehind) {
  RefreshRig rig;
  const nlohmann::json begun = rig.refresh({.left_behind = {"ble-0101"}});
  EXPECT_EQ(begun["robots"], mesh_size - 1) << begun;
  ASSERT_TRUE(rig.reaches("none"));
  EXPECT_TRUE(has_old_keys(rig.device(1)));
  EXPECT_EQ(std::ranges::count_if(
                rig.device(1).requests,
                [](const std::string& request) { return request.starts_with(net_key_update); }),
            0);
  EXPECT_EQ(rig.on_disk().find_address(0x0101), nullptr);
  EXPECT_TRUE(rig.on_disk().was_removed(*parse_uuid("736c616d020202020202020202020202")));
  EXPECT_TRUE(rig.has_notice("ble-0101 keeps the mesh's old keys"));
  EXPECT_FALSE(rig.has_notice("may have heard the new keys"));
  EXPECT_EQ(rig.board.subnets.front().second, octets(new_keys().net_key));
}

TEST(KeyRefresh, LeavesSilentRobotsBehindWhenAsked) {
  RefreshRig rig;
  rig.device(2).deaf_to = {net_key_update};
  rig.refresh();
  rig.pass(30s);
  rig.refresh({.left_behind = {}, .leaves_silent = true});
  ASSERT_TRUE(rig.reaches("none"));
  EXPECT_EQ(rig.on_disk().nodes.size(), mesh_size - 1);
  EXPECT_TRUE(rig.has_notice("may have heard the new keys"));
  EXPECT_TRUE(rig.board.devices.device_keys.empty());
}

TEST(KeyRefresh, LeavesRobotBehindDuringItsConversation) {
  RefreshRig rig(1);
  rig.device().deaf_to = {net_key_update};
  rig.refresh();
  rig.pass(5s);
  ASSERT_GT(rig.said(net_key_update), 0u);
  rig.refresh({.left_behind = {"ble-0100"}});
  ASSERT_TRUE(rig.reaches("none"));
  EXPECT_TRUE(rig.on_disk().nodes.empty());
  EXPECT_EQ(rig.on_disk().keys, new_keys());
}

TEST(KeyRefresh, DoesNotLeaveBehindRobotWithNewKeys) {
  RefreshRig rig;
  rig.device(2).deaf_to = {net_key_update};
  rig.refresh();
  rig.pass(30s);
  const std::string why = rig.refresh({.left_behind = {"ble-0100"}});
  EXPECT_NE(why.find("ble-0100 has the new keys already"), std::string::npos) << why;
  EXPECT_EQ(rig.refresh({.left_behind = {"nobody"}}),
            "no robot of this mesh is called nobody; see `ble nodes`");
  EXPECT_EQ(rig.on_disk().nodes.size(), mesh_size);
}

TEST(KeyRefresh, ContinuesAfterKillAtAnyMoment) {
  constexpr std::size_t few = 2;
  RefreshRig rig(few);
  std::vector<Moment> moments;
  rig.refresh();
  for (std::size_t before = 0; rig.stored.back().refresh; rig.run_for(2ms)) {
    const std::size_t seen = rig.stored.size() + rig.board.sent.size() + rig.board.count(0x92) +
                             rig.board.count(0x93) + rig.board.count(0xac);
    if (seen != before) moments.push_back({rig.board, rig.on_disk()});
    before = seen;
    ASSERT_LT(rig.now.time_since_epoch(), 10min);
  }
  ASSERT_GT(moments.size(), 4 * few + 4) << "requests to robots and to the board";
  for (std::size_t i = 0; i < moments.size(); ++i) {
    for (const bool loses_power : {false, true}) {
      SCOPED_TRACE(::testing::Message() << i << (loses_power ? ", and the board forgets" : ""));
      Moment moment = moments[i];
      const auto text = encode_node_database(moment.database);
      moment.database = *decode_node_database(text);
      moment.board.forgets = loses_power;
      if (loses_power) moment.board.restart();
      RefreshRig next(moment);
      ASSERT_TRUE(next.reaches("none"));
      EXPECT_TRUE(next.is_complete());
      EXPECT_EQ(next.on_disk().nodes.size(), few);
    }
  }
}

TEST(KeyRefresh, ShowsNoKey) {
  RefreshRig rig;
  rig.device(1).refuses = {{"01", 0x05}};
  rig.refresh();
  rig.pass(20s);
  rig.device(1).refuses.clear();
  ASSERT_TRUE(rig.reaches("none", 300s));
  std::vector<std::string> shown;
  for (const Notice& notice : rig.all<Notice>()) shown.push_back(notice.text);
  for (const OrderAnswer& answer : rig.answers) shown.push_back(answer.json + answer.error);
  for (const std::string& text : shown)
    for (const Key& key :
         {test_keys().net_key, test_keys().app_key, new_keys().net_key, new_keys().app_key})
      EXPECT_EQ(text.find(to_hex(key)), std::string::npos) << text;
}

TEST(KeyRefresh, IsRefusedInASharedMesh) {
  NodeDatabase shared = test_database();
  shared.gateways = {0x0021};
  ProvisioningRig rig({}, shared);
  rig.start();
  rig.order(RefreshKeysOrder{});
  EXPECT_NE(rig.answer().dump().find("other gateways have radios in this mesh"), std::string::npos);
  NodeDatabase guest = test_database();
  guest.guest_address = 0x0001;
  ProvisioningRig second({}, guest);
  second.start();
  second.order(RefreshKeysOrder{});
  EXPECT_NE(second.answer().dump().find("do it there"), std::string::npos);
  EXPECT_EQ(rig.keys_drawn + second.keys_drawn, 0);
}

TEST(KeyRefresh, RefusesExportAndImportAndLetsRobotsJoin) {
  RefreshRig rig;
  rig.device(0).deaf_to = {net_key_update};
  rig.refresh();
  rig.pass(1s);
  for (const BleOrder& order : {BleOrder(ExportOrder{}), BleOrder(ImportOrder{"{}"})}) {
    rig.order(order);
    EXPECT_EQ(rig.answer(), "the mesh's keys are being refreshed; see `ble refresh-keys --status`");
  }
  rig.add(9);
  EXPECT_TRUE(rig.all_configured(60s)) << "a new robot joins";
  rig.device(0).deaf_to.clear();
  ASSERT_TRUE(rig.reaches("none", 300s));
  EXPECT_TRUE(rig.is_complete());
}

TEST(KeyRefresh, ARobotJoinsWithTheNewKeysAtTheEnd) {
  RefreshRig rig;
  rig.device(0).deaf_to = {finish};
  rig.refresh();
  ASSERT_TRUE(rig.reaches("finishing"));
  rig.add(9);
  EXPECT_TRUE(rig.all_configured(60s));
  EXPECT_EQ(rig.missing_robot(), "ble-0100");
  rig.device(0).deaf_to.clear();
  ASSERT_TRUE(rig.reaches("none", 300s));
  EXPECT_TRUE(rig.is_complete());
}

TEST(KeyRefresh, ChangesTheKeysOfAMeshWithoutRobots) {
  RefreshRig rig(0);
  rig.refresh();
  ASSERT_TRUE(rig.reaches("none"));
  EXPECT_TRUE(rig.is_complete());
  EXPECT_TRUE(rig.is_up());
}

TEST(KeyRefresh, CanBeOrderedAgain) {
  RefreshRig rig;
  rig.refresh();
  ASSERT_TRUE(rig.reaches("none"));
  const std::size_t before = rig.said(finish);
  rig.refresh();
  ASSERT_TRUE(rig.reaches("none"));
  EXPECT_EQ(rig.said(finish), before + mesh_size);
  EXPECT_EQ(rig.source_of_an_answer(), 0x0003);
}

TEST(KeyRefresh, KeepsTheIvIndex) {
  RefreshRig rig;
  rig.say(hex("05 d3 07 00 00 00"));
  rig.refresh();
  ASSERT_TRUE(rig.reaches("none"));
  EXPECT_EQ(rig.on_disk().iv_index, 7u);
  rig.add(9);
  EXPECT_TRUE(rig.all_configured(10s));
  EXPECT_EQ(rig.board.devices.last_iv_index, 7u);
}

TEST(KeyRefresh, ClearsOnlyABoardOfThisMesh) {
  NodeDatabase database = test_database();
  database.keys = new_keys();
  database.refresh = RefreshState{RefreshStep::finishing, test_keys()};
  database.life = {.number = 1, .source = 0x0001};
  for (const bool is_ours : {true, false}) {
    ProvisioningRig rig({}, database);
    rig.board.unicast = 0x0001;
    rig.board.unicast_count = 32;
    rig.board.subnets = {{0, is_ours ? octets(test_keys().net_key) : Bytes(16, 0x99)}};
    rig.board.appkeys = {{0, octets(test_keys().app_key)}};
    rig.start();
    rig.run_for(5s);
    EXPECT_EQ(rig.is_up(), is_ours);
    EXPECT_EQ(rig.board.count(0xac), is_ours ? 1u : 0u);
    EXPECT_EQ(rig.has_notice("it holds another network key"), !is_ours);
  }
}

TEST(KeyRefresh, LinkRetriesWhenBoardKeepsFormerKeys) {
  RefreshRig rig(1);
  rig.board.status_of = {{0xac, 0x8d}};
  rig.refresh();
  rig.pass(60s);
  EXPECT_FALSE(rig.is_up());
  EXPECT_TRUE(rig.has_notice("it keeps the mesh's former keys"));
  rig.board.status_of.clear();
  ASSERT_TRUE(rig.reaches("none", 120s));
  EXPECT_TRUE(rig.is_complete());
}

TEST(KeyRefresh, RemoveReportsWhetherRobotWasReset) {
  RefreshRig rig(2);
  rig.order(RemoveOrder{"ble-0100", false});
  rig.pass(5s);
  EXPECT_EQ(rig.answer()["was_reset"], true) << rig.answer();
  rig.device(1).deaf_to = {"8049"};
  rig.order(RemoveOrder{"ble-0101", true});
  rig.pass(30s);
  EXPECT_EQ(rig.answer()["was_reset"], false) << rig.answer();
}

// --- Recorded answers of Nordic's code
// ---------------------------------------------------------------------

Key counting_from(std::uint8_t first) {
  Key key{};
  for (std::uint8_t& octet : key) octet = first++;
  return key;
}

TEST(KeyRefreshRecording, RobotAnswersEachStep) {
  const auto recorded = test::read_transcript("configuration.txt", "configuration", "3.1.0");
  const auto answer_to = [&](const ble::Exchange& asked, const auto&... params) {
    const Bytes request = config_step("", asked, params...).request;
    constexpr std::size_t request_at = 12;
    constexpr std::size_t answer_at = 21;
    std::set<std::string> answers;
    for (const test::Exchange& exchange : recorded.exchanges) {
      const Bytes& command = exchange.command;
      if (command.size() <= request_at ||
          Bytes(command.begin() + request_at, command.end()) != request)
        continue;
      for (const auto& packet : exchange.answers)
        if (packet.octets.size() > answer_at && packet.octets[1] == 0xd0)
          answers.insert(to_hex(ByteView(packet.octets).subspan(answer_at)));
    }
    return answers;
  };
  EXPECT_TRUE(answer_to(netkey_update, key_index_0, counting_from(0xa0)).contains("8044000000"));
  EXPECT_TRUE(
      answer_to(key_refresh_phase_set, key_index_0, std::uint8_t{2}).contains("801700000002"));
  EXPECT_EQ(answer_to(key_refresh_phase_set, key_index_0, std::uint8_t{3}),
            std::set<std::string>{"801700000000"});
  EXPECT_TRUE(
      answer_to(appkey_update, key_indexes_0, counting_from(0x90)).contains("800300000000"));
  EXPECT_TRUE(answer_to(appkey_update, key_indexes_0, counting_from(0x60)).contains("80030b000000"))
      << "no refresh was in progress";
}

/// A board that has an address, and key index 0 of both kinds.
Bytes table_answer(std::uint8_t opcode) {
  switch (opcode) {
    case 0x09: return hex("0a 00");
    case 0xa0: return hex("01 00 20 00");
    case 0x95: return hex("00 00");
    case 0x9a: return hex("00 00 00 00");
    default: return {};
  }
}

/// Runs a start-up to the end of its keys. Commands about keys get the recorded answers.
StartUp::State start_up_with(const RadioKeys& keys, std::string_view situation,
                             const std::string& release, std::vector<std::string>& said) {
  const auto recorded = test::read_transcript("situations.txt", situation, release);
  Settings settings;
  settings.groups.clear();
  StartUp start(settings, keys);
  while (start.state() == StartUp::State::commanding) {
    const Bytes command = start.command();
    CommandResponse response{command[1], Status::success, table_answer(command[1])};
    for (const test::Exchange& exchange : recorded.exchanges) {
      if (exchange.command != command) continue;
      const Bytes& packet = exchange.answers.back().octets;
      response = {command[1], Status{packet[3]}, {packet.begin() + 4, packet.end()}};
      said.push_back(to_hex(command).substr(2, 2) + " " + to_hex(ByteView(packet).subspan(3, 1)));
    }
    start.on_response(response);
  }
  return start.state();
}

TEST(KeyRefreshRecording, BoardWithBothKeysIsRecognizedByFormerKey) {
  for (const std::string& release : test::releases_of("situations.txt")) {
    std::vector<std::string> said;
    const RadioKeys keys{{counting_from(0xa0), counting_from(0x90)},
                         {},
                         MeshKeys{counting_from(0x10), counting_from(0x20)}};
    EXPECT_EQ(start_up_with(keys, "situation_12", release, said), StartUp::State::needs_clear);
    EXPECT_EQ(said.back(), "92 81") << release;
  }
}

TEST(KeyRefreshRecording, ABoardHearsBothKeys) {
  for (const std::string& release : test::releases_of("situations.txt")) {
    std::vector<std::string> said;
    const RadioKeys keys{{counting_from(0x10), counting_from(0x20)},
                         MeshKeys{counting_from(0xa0), counting_from(0x90)},
                         {}};
    EXPECT_EQ(start_up_with(keys, "situation_13", release, said), StartUp::State::needs_source);
    EXPECT_NE(std::ranges::find(said, "93 00"), said.end()) << release;
    EXPECT_NE(std::ranges::find(said, "98 00"), said.end()) << release;
  }
}

}  // namespace
}  // namespace slamgw::ble
