// SPDX-License-Identifier: Apache-2.0
// Serial lines that lose or add octets, and boards that are slow or busy. Tests check the state of
// the link and the messages for the operator.
#include <gtest/gtest.h>

#include <random>

#include "tests/ble_mesh_usb_cdc/provisioning_rig.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;

bool is_from_board(const Bytes& transfer) {
  return transfer.size() > 1 && (transfer[1] & 0x80) != 0 && transfer[1] != 0x90 &&
         (transfer[1] < 0x92 || transfer[1] > 0xac);
}

/// Returns all messages for an operator.
std::vector<std::string> texts(const MeshRig& rig) {
  std::vector<std::string> all;
  for (const auto& change : rig.all<LinkChange>()) all.push_back(change.detail);
  for (const auto& notice : rig.all<Notice>()) all.push_back(notice.text);
  return all;
}

TEST(LineTrouble, LinkGoesDownAndReportsStrayOctetWithEachCommand) {
  MeshRig rig;
  rig.spoil = [](Bytes& transfer) {
    if (is_from_board(transfer)) transfer.insert(transfer.begin(), 0x41);
  };
  rig.start();
  rig.run_for(20s);
  EXPECT_TRUE(rig.has_notice("octets are lost or added"));
  const auto changes = rig.all<LinkChange>();
  ASSERT_EQ(changes.size(), 1u);
  EXPECT_FALSE(changes[0].is_up);
  EXPECT_NE(changes[0].detail.find("octets are lost or added"), std::string::npos);
  ASSERT_FALSE(rig.reopens.empty());

  rig.run_for(30min);
  EXPECT_EQ(rig.reopens.back(), 60s);
  EXPECT_LT(rig.counter("resyncs"), 400u) << "it backs off";
  EXPECT_LT(texts(rig).size(), 40u) << "at most one line each minute";
  EXPECT_EQ(rig.all<LinkChange>().size(), 1u);

  rig.spoil = nullptr;
  rig.run_for(90s);
  EXPECT_TRUE(rig.is_up());
}

TEST(LineTrouble, LinkStaysUpWithOccasionalStrayOctet) {
  MeshRig rig;
  rig.start();
  for (int i = 0; i < 20; ++i) {
    rig.say(hex("00"));
    rig.run_for(30s);
    EXPECT_TRUE(rig.is_up());
  }
  EXPECT_EQ(rig.all<LinkChange>().size(), 1u);
  EXPECT_FALSE(rig.has_notice("octets are lost"));
  EXPECT_EQ(rig.counter("resyncs"), 21u);
}

TEST(LineTrouble, LostOctetsAreNotBlamedOnTheFirmware) {
  for (const unsigned seed : {1u, 5u, 6u}) {
    SCOPED_TRACE(seed);
    MeshRig rig;
    rig.start();  // the board gets its keys undamaged
    std::mt19937 random(seed);
    rig.spoil = [&random](Bytes& transfer) {
      std::erase_if(transfer, [&](std::uint8_t) { return random() % 50 == 0; });
    };
    rig.say(rig.board.restart());
    rig.run_for(5min);
    for (const std::string& text : texts(rig)) {
      EXPECT_EQ(text.find("firmware"), std::string::npos) << text;
      EXPECT_EQ(text.find("not Nordic's"), std::string::npos) << text;
      EXPECT_EQ(text.find("the serial board does not answer"), std::string::npos) << text;
    }
    rig.spoil = nullptr;
    rig.run_for(3min);
    EXPECT_TRUE(rig.is_up()) << ::testing::PrintToString(texts(rig));
  }
}

TEST(LineTrouble, ABoardOfAnotherMeshIsNeverClearedOnALineThatLosesOctets) {
  for (const unsigned seed : {1u, 2u, 3u}) {
    SCOPED_TRACE(seed);
    MeshRig rig;
    rig.board.unicast = seed == 1 ? 0x0042 : 0x0001;
    rig.board.subnets = {{std::uint16_t{0}, Bytes(16, 0x77)}};
    std::mt19937 random(seed);
    rig.spoil = [&random](Bytes& transfer) {
      std::erase_if(transfer, [&](std::uint8_t) { return random() % 50 == 0; });
    };
    rig.start();
    rig.run_for(5min);
    EXPECT_EQ(rig.board.count(0xac), 0u);
    EXPECT_EQ(rig.board.subnets.at(0).second, Bytes(16, 0x77));
    EXPECT_FALSE(rig.is_up());
  }
}

/// The gateway cannot distinguish octets lost on the line from another host that used the board.
TEST(LineTrouble, BoardWithDamagedKeysIsClearedOnlyByOperator) {
  ProvisioningRig rig;
  bool was_spoiled = false;
  rig.spoil = [&](Bytes& transfer) {
    if (was_spoiled || transfer.size() < 2 || transfer[1] != 0x92) return;
    was_spoiled = true;
    transfer.erase(transfer.begin() + 10);
  };
  rig.open();
  rig.run_for(5min);
  EXPECT_FALSE(rig.is_up());
  EXPECT_EQ(rig.board.count(0xac), 0u);
  EXPECT_TRUE(rig.has_notice("or its key arrived damaged"));
  rig.order(ResetBoardOrder{});
  rig.run_for(10s);
  EXPECT_TRUE(rig.is_up());
  EXPECT_EQ(rig.board.subnets.at(0).second, Bytes(16, 0x11));
}

TEST(LineTrouble, ABoardThatWasFreshAndGotItsKeysElsewhereIsNotCleared) {
  MeshRig rig({}, std::nullopt);
  rig.answers_stores = false;
  rig.start();
  ASSERT_EQ(rig.keys_drawn, 2) << "a fresh board";
  rig.mesh.on_port_closed("unplugged", rig.now);
  rig.board.unicast = 1;
  rig.board.subnets = {{std::uint16_t{0}, Bytes(16, 0x77)}};
  rig.answers_stores = true;
  rig.mesh.on_stored({}, rig.now);
  rig.start();
  rig.run_for(5min);
  EXPECT_FALSE(rig.is_up());
  EXPECT_EQ(rig.board.count(0xac), 0u);
  EXPECT_EQ(rig.board.subnets.at(0).second, Bytes(16, 0x77));
}

TEST(LineTrouble, ABoardThatAnswersAfterTwoSecondsComesUp) {
  MeshRig rig;
  rig.latency = 1900ms;
  rig.open();
  rig.run_for(60s);
  EXPECT_TRUE(rig.is_up());
  EXPECT_TRUE(rig.reopens.empty());
}

TEST(LineTrouble, ABoardThatIsMuteForFiveSecondsAfterResetComesUp) {
  MeshRig rig;
  rig.board.is_silent = true;
  rig.open();
  rig.run_for(5s);
  rig.board.is_silent = false;
  rig.run_for(5s);
  EXPECT_TRUE(rig.is_up());
  EXPECT_EQ(rig.all<LinkChange>().size(), 1u) << "the silence was not reported";
}

TEST(LineTrouble, ABoardThatIsBusyForAMomentDuringStartUpComesUpAtOnce) {
  for (const std::uint8_t opcode : hex("9f 92 97 a8 a1 90")) {
    SCOPED_TRACE(static_cast<int>(opcode));
    MeshRig rig;
    rig.board.status_of[opcode] = 0x86;
    rig.open();
    rig.run_for(1s);
    EXPECT_FALSE(rig.is_up());
    rig.board.status_of.clear();
    rig.run_for(500ms);
    EXPECT_TRUE(rig.is_up());
    EXPECT_EQ(rig.all<LinkChange>().size(), 1u);
    EXPECT_FALSE(rig.has_notice("busy"));
  }
}

TEST(LineTrouble, ReportsBoardThatStaysBusy) {
  MeshRig rig;
  rig.board.status_of[0x92] = 0x86;
  rig.open();
  rig.run_for(20s);
  EXPECT_FALSE(rig.is_up());
  EXPECT_TRUE(rig.has_notice("answers \"busy\""));
}

TEST(LineTrouble, OneDamagedAnswerDoesNotRefuseABoard) {
  const std::vector<std::pair<std::string, std::string>> damages{
      {"07 84 a0 00 00 00 00 00", "07 84 a0 00 42 00 01 00"},  // another address
      {"03 84 9f 00", "03 84 9f 8e"},
      {"05 84 92 00 00 00", "03 84 92 8e"},  // another mesh's key
      {"05 84 97 00 00 00", "03 84 97 8e"},
      {"05 84 09 00 0a 00", "05 84 09 00 01 00"}};
  for (const auto& [answer, damaged] : damages) {
    SCOPED_TRACE(damaged);
    MeshRig rig;
    bool was_spoiled = false;
    rig.spoil = [&, wanted = hex(answer), spoiled = hex(damaged)](Bytes& transfer) {
      if (!was_spoiled && transfer == wanted) {
        was_spoiled = true;
        transfer = spoiled;
      }
    };
    rig.open();
    rig.run_for(2s);
    EXPECT_TRUE(was_spoiled);
    EXPECT_TRUE(rig.is_up());
    EXPECT_FALSE(rig.has_notice("can't be used"));
  }
}

}  // namespace
}  // namespace slamgw::ble
