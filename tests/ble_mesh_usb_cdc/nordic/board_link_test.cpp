// SPDX-License-Identifier: Apache-2.0
// The link to the board, seen through BleMesh: boards in every state, silence, restarts.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include "tests/ble_mesh_usb_cdc/mesh_rig.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;

Bytes key(std::uint8_t octet) { return Bytes(16, octet); }

void configure(FakeBoard& board, std::uint16_t address = 0x0001) {
  board.unicast = address;
  board.subnets = {{std::uint16_t{0}, key(0x11)}};
  board.appkeys = {{std::uint16_t{0}, key(0x22)}};
}

TEST(BoardLink, ConfiguresAFreshBoard) {
  MeshRig rig;
  rig.board.is_enabled = false;
  rig.start();
  EXPECT_TRUE(rig.is_up());
  EXPECT_EQ(rig.board.unicast, 0x0001);
  EXPECT_EQ(rig.board.subnets.at(0).second, key(0x11));
  EXPECT_EQ(rig.board.appkeys.at(0).second, key(0x22));
  EXPECT_TRUE(rig.board.is_enabled);
  for (const std::uint16_t group : Settings{}.groups)
    EXPECT_TRUE(rig.board.handle_of(group)) << group;
  EXPECT_TRUE(rig.has_notice("was fresh"));
}

TEST(BoardLink, UsesABoardThatHasTheSameKeys) {
  MeshRig rig;
  configure(rig.board);
  rig.board.addresses = {FakeBoard::Address{0xc003, true, 0}, FakeBoard::Address{0x0100, false, 1}};
  rig.start();
  EXPECT_TRUE(rig.is_up());
  EXPECT_EQ(rig.board.count(0xa1), 2u) << "only the missing groups are added";
  rig.hear(0x0100, "ca 59 00");
  rig.run_for(100ms);
  EXPECT_EQ(rig.sent_to(0x0100).size(), 1u);
  EXPECT_EQ(rig.board.count(0xa4), 0u) << "the handle was on the board";
}

TEST(BoardLink, AsksForKeysOnlyForAFreshBoard) {
  MeshRig rig({}, std::nullopt);
  rig.start();
  EXPECT_EQ(rig.keys_drawn, 2);
  EXPECT_TRUE(rig.is_up());
  EXPECT_EQ(rig.board.subnets.at(0).second, key(0x11));
}

TEST(BoardLink, AsksForKeysOnceThoughBoardRestartsWhileTheyAreStored) {
  MeshRig rig({}, std::nullopt);
  rig.answers_stores = false;  // the disk is slow
  rig.start();
  rig.say(rig.board.restart());
  rig.run_for(1s);
  rig.mesh.on_port_closed("unplugged", rig.now);
  rig.open();
  rig.answers_stores = true;
  rig.mesh.on_stored({}, rig.now);
  rig.run_for(2s);
  EXPECT_EQ(rig.keys_drawn, 2);
  EXPECT_TRUE(rig.is_up());
  EXPECT_EQ(rig.board.subnets.at(0).second, key(0x11));
}

TEST(BoardLink, UsesConfiguredBoardUnchangedWithoutKnownKeys) {
  MeshRig rig({}, std::nullopt);
  configure(rig.board);
  rig.board.subnets[0].second = key(0x77);
  rig.start();
  EXPECT_TRUE(rig.is_up());
  EXPECT_EQ(rig.keys_drawn, 0);
  EXPECT_EQ(rig.board.count(0x92) + rig.board.count(0x97), 0u);
  EXPECT_TRUE(rig.has_notice("used as it is"));
}

TEST(BoardLink, RefusesABoardOfAnotherMeshAndNeverWipesIt) {
  MeshRig rig;
  configure(rig.board);
  rig.board.subnets[0].second = key(0x77);
  rig.start();
  rig.run_for(120s);
  EXPECT_FALSE(rig.is_up());
  EXPECT_EQ(rig.count_notices("another network key"), 1);
  EXPECT_EQ(rig.board.subnets[0].second, key(0x77));
  EXPECT_EQ(rig.board.count(0xac), 0u);
  rig.board.subnets[0].second = key(0x11);  // the operator fixes it
  rig.run_for(40s);
  EXPECT_TRUE(rig.is_up());
}

TEST(BoardLink, RefusesABoardWithAnotherAddress) {
  MeshRig rig;
  configure(rig.board, 0x0042);
  rig.start();
  EXPECT_FALSE(rig.is_up());
  EXPECT_TRUE(rig.has_notice("0x0042"));
  EXPECT_EQ(rig.board.count(0x9f), 0u);
}

TEST(BoardLink, RefusesWhenKeysCannotBeStored) {
  MeshRig rig({}, std::nullopt);
  rig.store_problem = "disk full";
  rig.start();
  EXPECT_FALSE(rig.is_up());
  EXPECT_TRUE(rig.has_notice("disk full"));
  EXPECT_TRUE(rig.board.subnets.empty());
  rig.store_problem.clear();
  rig.run_for(40s);
  EXPECT_TRUE(rig.is_up());
  EXPECT_EQ(rig.keys_drawn, 4) << "new ones, as the first ones may be on disk";
}

TEST(BoardLink, RefusesWhenNoKeysCanBeMade) {
  MeshRig rig({}, std::nullopt);
  rig.has_randomness = false;
  rig.start();
  EXPECT_FALSE(rig.is_up());
  EXPECT_TRUE(rig.has_notice("no randomness for the mesh's keys"));
  EXPECT_TRUE(rig.stored.empty());
  rig.has_randomness = true;
  rig.run_for(40s);
  EXPECT_TRUE(rig.is_up());
}

TEST(BoardLink, SynchronisesBoardInMiddleOfPacket) {
  for (const std::string_view torn : {"ff", "ff 02 41", "41 54 0d", "05 02 61"}) {
    MeshRig rig;
    rig.board.on_bytes(hex(torn));
    ASSERT_TRUE(rig.board.is_mid_packet());
    rig.start();
    EXPECT_TRUE(rig.is_up()) << torn;
    EXPECT_EQ(rig.counter("resyncs"), 1u) << torn << ": one attempt is enough";
  }
}

TEST(BoardLink, SynchronisesWhileRobotsKeepSending) {
  MeshRig rig;
  configure(rig.board);
  rig.open();
  for (int i = 0; i < 40; ++i) {  // never quiet for 300 ms
    rig.say(rig.board.message(0x0100, hex("cb 59 00 0a 00 ec ff")));
    rig.run_for(50ms);
  }
  EXPECT_TRUE(rig.is_up());
}

TEST(BoardLink, ReopensThePortWithBackOffWhenBoardStaysSilent) {
  MeshRig rig;
  rig.board.is_silent = true;
  rig.start();
  rig.run_for(60s);
  ASSERT_GE(rig.reopens.size(), 5u);
  EXPECT_EQ(rig.reopens[0], 500ms);
  EXPECT_EQ(rig.reopens[1], 1s);
  EXPECT_EQ(rig.reopens.back(), 5s);
  ASSERT_EQ(rig.all<LinkChange>().size(), 1u) << "the reason did not change";
  EXPECT_NE(rig.all<LinkChange>()[0].detail.find("does not answer: "), std::string::npos);
  EXPECT_EQ(rig.count_notices("the serial board does not answer"), 0)
      << "reported in the link change only";
  rig.board.is_silent = false;
  rig.run_for(10s);
  EXPECT_TRUE(rig.is_up());
}

TEST(BoardLink, ReportsDeviceThatIsNotSerialBoard) {
  MeshRig rig;
  rig.board.is_silent = true;
  rig.reopens_port = false;
  rig.start();
  rig.say(to_bytes("login: "));
  rig.run_for(10s);
  const std::string why = rig.all<LinkChange>().back().detail;
  EXPECT_NE(why.find("not Nordic's serial protocol: "), std::string::npos) << why;
  EXPECT_NE(why.find("ble_mesh.device"), std::string::npos) << "what to do: " << why;
}

TEST(BoardLink, StartsAgainWhenTheBoardRestarts) {
  MeshRig rig;
  rig.start();
  const std::size_t enables = rig.board.count(0x90);
  rig.say(rig.board.restart());
  EXPECT_FALSE(rig.is_up());
  rig.run_for(1s);
  EXPECT_TRUE(rig.is_up());
  EXPECT_EQ(rig.board.count(0x90), enables + 1);
}

TEST(BoardLink, ResynchronisesAfterALostAnswerAndStaysUp) {
  MeshRig rig;
  rig.start();
  rig.board.ignore_command_number = rig.board.commands.size() + 1;  // 0xa4, then the lost 0xab
  rig.hear(0x0100, "ca 59 00");
  rig.run_for(10s);
  EXPECT_TRUE(rig.is_up());
  EXPECT_EQ(rig.all<LinkChange>().size(), 1u);
  rig.hear(0x0100, "ca 59 00");
  rig.run_for(1s);
  EXPECT_EQ(rig.sent_to(0x0100).size(), 2u);
}

TEST(BoardLink, ResynchronisesWhenBoardHasLostSynchronisation) {
  MeshRig rig;
  rig.start();
  rig.say(hex("03 84 00 84"));
  rig.run_for(2s);
  EXPECT_TRUE(rig.is_up());
  EXPECT_EQ(rig.board.count(0x02), 2u);
}

TEST(BoardLink, GoesDownWhenACommandIsNeverAnswered) {
  MeshRig rig;
  rig.start();
  rig.board.ignored = {0xab};
  for (int i = 0; i < 3; ++i) {
    rig.hear(0x0100, "ca 59 00");
    rig.run_for(4s);
  }
  const auto changes = rig.all<LinkChange>();
  EXPECT_TRUE(std::ranges::any_of(changes, [](const LinkChange& change) {
    return change.detail.find("not command 0xab: ") != std::string::npos;
  }));
  EXPECT_FALSE(rig.reopens.empty());
}

/// Starts a fresh board repeatedly; calls `fail` after 0, 1, 2 ... commands.
template <class Fail>
void for_each_step(Fail fail) {
  MeshRig whole;
  whole.start();
  const std::size_t steps = whole.board.commands.size();
  ASSERT_GT(steps, 10u);
  for (std::size_t step = 0; step < steps; ++step) {
    SCOPED_TRACE(step);
    MeshRig rig;
    rig.open();
    while (rig.board.commands.size() < step) rig.run_for(1ms);
    fail(rig);
    rig.run_for(60s);
    EXPECT_TRUE(rig.is_up());
    EXPECT_EQ(rig.board.subnets.size(), 1u);
    EXPECT_EQ(rig.board.appkeys.size(), 1u);
    EXPECT_EQ(rig.board.addresses.size(), 3u);
  }
}

TEST(BoardLink, StartsUpWhicheverAnswerIsLost) {
  for_each_step([](MeshRig& rig) { rig.board.ignore_command_number = rig.board.commands.size(); });
}

TEST(BoardLink, StartsUpWhereverTheBoardFallsSilentForAWhile) {
  for_each_step([](MeshRig& rig) {
    rig.board.is_silent = true;
    rig.run_for(20s);
    EXPECT_FALSE(rig.is_up() && rig.all<LinkChange>().size() == 1u);
    rig.board.is_silent = false;
  });
}

TEST(BoardLink, StartsUpWhereverTheBoardRestarts) {
  for_each_step([](MeshRig& rig) { rig.say(rig.board.restart()); });
}

TEST(BoardLink, StartsUpWhereverThePortIsLost) {
  for_each_step([](MeshRig& rig) {
    rig.mesh.on_port_closed("unplugged", rig.now);
    rig.run_for(1s);
    rig.open();
  });
}

TEST(BoardLink, StartsUpWhicheverAnswerIsTruncated) {
  for_each_step([](MeshRig& rig) {
    rig.spoil = [&rig](Bytes& transfer) {
      if (transfer.size() < 2 || transfer[1] != 0x84) return;
      transfer.pop_back();
      rig.spoil = nullptr;
    };
  });
}

TEST(BoardLink, CountsEventsThatBoardDropped) {
  MeshRig rig;
  rig.board.dropped = 100;  // before this start
  rig.start();
  rig.board.dropped = 103;
  rig.run_for(11s);
  EXPECT_TRUE(rig.has_notice("dropped 3 event(s)"));
}

/// The board has room for few events, and reports a device key once.
TEST(BoardLink, DelaysCommandsWhileDeviceJoins) {
  const auto key = hex("2c c5 00") + Bytes(42, 0);
  for (const Bytes& end : {key, hex("03 c2 00 02")}) {
    MeshRig rig;
    rig.start();
    rig.say(hex("02 c1 00"));
    rig.command("nr1/cmd", hex("01 00 02 00"));
    rig.run_for(5s);
    EXPECT_TRUE(rig.sent_to(0x0100).empty());
    rig.hear(0x0100, "ca 59 00");
    rig.run_for(10ms);
    EXPECT_EQ(rig.sent_to(0x0100), std::vector<std::string>{"cc590000"})
        << "a robot repeats its message until it gets its STATUS";
    rig.say(end);
    rig.run_for(10ms);
    EXPECT_EQ(rig.sent_to(0x0100).size(), 2u) << "the STATUS and the command";
  }
}

TEST(BoardLink, SendsDelayedCommandsAfterTimeLimit) {
  MeshRig rig;
  rig.start();
  rig.say(hex("02 c1 00"));
  rig.command("nr1/cmd", hex("01 00 02 00"));
  rig.run_for(BoardRadio::longest_hold - 1ms);
  EXPECT_TRUE(rig.sent_to(0x0100).empty());
  rig.run_for(10ms);
  EXPECT_EQ(rig.sent_to(0x0100).size(), 1u);
}

TEST(BoardLink, SendsAcknowledgementsWhileQueueOfCommandsIsFull) {
  MeshRig rig;
  rig.start();
  rig.say(hex("02 c1 00"));
  for (std::uint16_t robot = 0x0200; robot < 0x0200 + 40; ++robot) {
    rig.hear(robot, "c7 59 00 01");
    rig.command(fmt::format("ble-{:04x}/hello", robot), to_bytes("hello"));
  }
  rig.hear(0x0100, "ca 59 00");
  rig.run_for(10ms);
  EXPECT_EQ(rig.sent_to(0x0100).size(), 1u);
}

TEST(BoardLink, WarnsWhenAGroupCannotBeHeard) {
  MeshRig rig;
  rig.board.status_of[0xa1] = 0x8e;
  rig.start();
  EXPECT_TRUE(rig.is_up());
  EXPECT_TRUE(rig.has_notice("0xc003"));
}

TEST(BoardLink, ReplacesHandlesInBoardsFullAddressTable) {
  MeshRig rig;
  rig.start();
  for (std::uint16_t robot = 0x0200; robot < 0x0200 + 40; ++robot) {
    rig.hear(robot, "ca 59 00");
    rig.run_for(50ms);
    EXPECT_EQ(rig.sent_to(robot).size(), 1u) << robot;
  }
  EXPECT_EQ(rig.board.count(0xa6), 11u);  // 32 less three groups leaves 29 robots
  EXPECT_TRUE(rig.board.handle_of(0xc003));
}

TEST(BoardLink, AddsHandleOnceWhenSendsAreRejectedRepeatedly) {
  MeshRig rig;
  rig.start();
  rig.hear(0x0200, "ca 59 00");
  rig.run_for(50ms);
  rig.board.status_of[0xab] = 0x8e;  // for example an unknown key
  for (int i = 0; i < 5; ++i) {
    rig.hear(0x0200, "ca 59 00");
    rig.run_for(50ms);
  }
  const auto handle = rig.board.handle_of(0x0200);
  ASSERT_TRUE(handle);
  EXPECT_EQ(rig.board.addresses[*handle]->published, 1) << "one removal frees it";
  rig.board.status_of.clear();
  rig.board.addresses[*handle].reset();  // now the handle is unknown
  for (int i = 0; i < 2; ++i) {
    rig.hear(0x0200, "ca 59 00");
    rig.run_for(50ms);
  }
  EXPECT_EQ(rig.sent_to(0x0200).size(), 2u);
}

TEST(BoardLink, ReplacesHandlesInSmallerAddressTable) {
  MeshRig rig;
  rig.board.max_addresses = 5;
  rig.start();
  for (std::uint16_t robot = 0x0200; robot < 0x0205; ++robot) {
    rig.hear(robot, "ca 59 00");
    rig.run_for(50ms);
    EXPECT_EQ(rig.sent_to(robot).size(), 1u) << robot;
  }
}

TEST(BoardLink, SpeaksWithFirmwareOfEachVersion) {
  for (std::uint16_t version = 5; version <= 11; ++version) {
    SCOPED_TRACE(version);
    MeshRig rig;
    rig.board.serial_version = version;
    rig.start();
    rig.hear(0x0100, "ca 59 00");
    rig.run_for(100ms);
    ASSERT_EQ(rig.sent_to(0x0100).size(), 1u);
    EXPECT_EQ(rig.sent_to(0x0100)[0], "cc590000");
  }
}

TEST(BoardLink, RefusesFirmwareThatIsOlderThanTheProtocol) {
  MeshRig rig;
  rig.board.serial_version = 4;
  rig.start();
  EXPECT_FALSE(rig.is_up());
  EXPECT_TRUE(rig.has_notice("version 4 of Nordic's serial protocol"));
  EXPECT_EQ(rig.board.count(0x9f) + rig.board.count(0x92), 0u) << "the board is not changed";
}

TEST(BoardLink, RefusesCommandsThatOldFirmwareCannotSend) {
  MeshRig rig;
  rig.board.serial_version = 6;
  rig.start();
  rig.hear(0x0100, "c9 59 00 0a 00 ec ff");
  rig.command("nr1/hello", Bytes(86, 'x'));
  const auto outcomes = rig.all<CommandOutcome>();
  ASSERT_EQ(outcomes.size(), 1u);
  EXPECT_EQ(outcomes[0].result, CommandResult::refused);
  EXPECT_NE(outcomes[0].why.find("sends at most 85"), std::string::npos) << outcomes[0].why;
  EXPECT_TRUE(rig.sent_to(0x0100).empty());
  rig.command("nr1/hello", Bytes(85, 'x'));
  rig.run_for(100ms);
  EXPECT_EQ(rig.sent_to(0x0100).size(), 1u);
}

TEST(BoardLink, ReportsMissingPortOnce) {
  MeshRig rig;
  for (int i = 0; i < 5; ++i) rig.mesh.on_port_closed("no serial board at /dev/x", rig.now);
  rig.run_for(1s);
  rig.start();
  EXPECT_EQ(rig.all<LinkChange>().size(), 2u);
  EXPECT_TRUE(rig.is_up());
}

}  // namespace
}  // namespace slamgw::ble
