// SPDX-License-Identifier: Apache-2.0
// Two boards, each with a host of its own, and robots that both hear.
#include <gtest/gtest.h>

#include <array>

#include "simulation/ble/network.hpp"
#include "tests/simulation/hex.hpp"

namespace slamgw::sim::ble {
namespace {

using namespace std::chrono_literals;

class TwoBoards : public ::testing::Test {
 protected:
  static BleOptions options() {
    BleOptions options;
    options.ttys = {"", ""};
    options.common.robots = 1;
    options.common.messages = 20;
    options.is_acknowledged = true;
    return options;
  }
  /// Runs two boards; only `answering` acknowledges messages.
  void run(const BleOptions& options, std::size_t answering) {
    network_.emplace(options);
    answering_ = answering;
    network_->on_start(now_);
    set_up(0, "05 9f 01 00 01 00");
    set_up(1, "05 9f 02 00 01 00");
    const TimePoint end = now_ + 60s;
    while (!network_->has_sent_everything() && network_->deadline() <= end) {
      now_ = std::max(now_, network_->deadline());
      network_->on_deadline(now_);
      fetch();
    }
  }
  void set_up(std::size_t board, const char* address) {
    for (const char* command :
         {address, "13 92 00 00 00 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d 0e 0f",
          "15 97 00 00 00 00 10 11 12 13 14 15 16 17 18 19 1a 1b 1c 1d 1e 1f", "03 a1 02 c0",
          "03 a1 03 c0", "03 a4 00 01"})
      network_->on_host_bytes(hex(command), now_, board);
    fetch();
  }
  void fetch() {
    for (std::size_t board = 0; board < 2; ++board) {
      while (auto packet = network_->next_host_packet(now_, board)) {
        if ((*packet)[1] != 0xd1) continue;
        Side& side = sides_[board];
        ++side.heard;
        side.rssi_sum += static_cast<std::int8_t>((*packet)[18]);
        if (board != answering_) continue;
        Bytes send = hex("0e ab 00 00 01 00 02 00 04 00 00 00 00 59 00");
        send[4] = static_cast<std::uint8_t>(1 + board);
        send[12] = static_cast<std::uint8_t>((*packet)[21] + 3);
        network_->on_host_bytes(send, now_, board);
      }
    }
  }
  int rssi_of(std::size_t board) const { return sides_[board].rssi_sum / sides_[board].heard; }
  std::uint64_t acknowledged() const { return network_->robots()[0].tally().acknowledged; }

  struct Side {
    int heard = 0;
    int rssi_sum = 0;
  };
  TimePoint now_{};
  std::optional<Network> network_;
  std::size_t answering_ = 0;
  std::array<Side, 2> sides_;
};

TEST_F(TwoBoards, BothHearAndEitherCanAnswer) {
  for (const std::size_t answering : {0U, 1U}) {
    sides_ = {};
    run(options(), answering);
    EXPECT_EQ(acknowledged(), 20U);
    EXPECT_EQ(sides_[0].heard, 21) << "with the introduction";
    EXPECT_EQ(sides_[1].heard, 21);
  }
}

TEST_F(TwoBoards, EachHasItsOwnRadio) {
  BleOptions uneven = options();
  uneven.board_loss = {0.5, 0};
  uneven.board_level_db = {0, -20};
  run(uneven, 1);
  EXPECT_EQ(acknowledged(), 20U);
  EXPECT_EQ(sides_[1].heard, 21);
  EXPECT_LT(sides_[0].heard, 20);
  EXPECT_GT(sides_[0].heard, 0);
  EXPECT_NEAR(rssi_of(0) - rssi_of(1), 20, 5);
}

TEST_F(TwoBoards, OneFadesOutAndComesBack) {
  BleOptions fading = options();
  fading.common.messages = 100;  // 20 s
  fading.board_fade_s = {10, 0};
  run(fading, 1);
  EXPECT_EQ(acknowledged(), 100U);
  EXPECT_EQ(sides_[1].heard, 101);
  EXPECT_GT(sides_[0].heard, 40) << "it loses a third: the mean of a triangle's square";
  EXPECT_LT(sides_[0].heard, 90);
  EXPECT_LT(rssi_of(0), rssi_of(1) - 5) << "its messages have a lower signal level";
}

TEST_F(TwoBoards, OneWorksWhileOtherIsUnplugged) {
  BleOptions endless = options();
  endless.common.messages = 200;
  network_.emplace(endless);
  answering_ = 1;
  network_->on_start(now_);
  set_up(0, "05 9f 01 00 01 00");
  set_up(1, "05 9f 02 00 01 00");
  const auto pass = [&](Duration time) {
    for (const TimePoint end = now_ + time; network_->deadline() <= end; fetch()) {
      now_ = std::max(now_, network_->deadline());
      network_->on_deadline(now_);
    }
  };
  pass(5s);
  const std::uint64_t before = acknowledged();
  const int heard = sides_[0].heard;
  network_->reboot_board(now_, 2100ms, 0);
  pass(2s);
  EXPECT_GT(acknowledged(), before + 5);
  EXPECT_EQ(sides_[0].heard, heard);
  pass(200ms);
  set_up(0, "05 9f 01 00 01 00");
  pass(5s);
  EXPECT_GT(sides_[0].heard, heard);
}

}  // namespace
}  // namespace slamgw::sim::ble
