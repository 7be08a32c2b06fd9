// SPDX-License-Identifier: Apache-2.0
// Board, air and robots together on a virtual clock, with a host that sets the board up.
#include "simulation/ble/network.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <map>

#include "tests/simulation/hex.hpp"

namespace slamgw::sim::ble {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

class NetworkTest : public ::testing::Test {
 protected:
  void begin(BleOptions options) {
    network_.emplace(options);
    network_->on_start(now_);
    fetch();
  }
  void set_up() {
    for (const char* command :
         {"05 9f 01 00 01 00", "13 92 00 00 00 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d 0e 0f",
          "15 97 00 00 00 00 10 11 12 13 14 15 16 17 18 19 1a 1b 1c 1d 1e 1f", "03 a1 02 c0",
          "03 a1 03 c0", "03 a4 00 01", "03 a4 01 01", "03 a4 02 01"}) {
      tell(command);
    }
  }
  void tell(std::string_view command) {
    network_->on_host_bytes(hex(command), now_);
    fetch();
  }
  void fetch() {
    while (auto packet = network_->next_host_packet(now_)) {
      const std::uint8_t event = (*packet)[1];
      if (event != 0xd0 && event != 0xd1) continue;
      const Address source = get_u16_le(*packet, 2);
      last_ttl_ = (*packet)[10];
      Bytes payload(packet->begin() + 21, packet->end());
      if (acknowledges_ && (payload[0] == 0xc9 || payload[0] == 0xc5)) acknowledge(source, payload);
      heard_[source].push_back(std::move(payload));
    }
  }
  /// Publication handles 2.. belong to the robots 0x0100 ..
  void acknowledge(Address source, const Bytes& payload) {
    Bytes send = hex("0e ab 00 00 01 00 00 00 04 00 00 00 00 59 00");
    send[6] = static_cast<std::uint8_t>(source - first_robot + 2);
    send[12] = static_cast<std::uint8_t>(payload[0] + 3);
    network_->on_host_bytes(send, now_);
  }
  void run(Duration limit) {
    const TimePoint end = now_ + limit;
    while (!network_->has_sent_everything() && network_->deadline() <= end) {
      now_ = std::max(now_, network_->deadline());
      network_->on_deadline(now_);
      fetch();
    }
  }
  /// Returns the payloads of the first message and the updates, without opcodes and repeats.
  std::vector<Bytes> said_by(Address robot) const {
    std::vector<Bytes> out;
    for (const Bytes& payload : heard_.at(robot)) {
      if (payload[0] < 0xc5) continue;
      Bytes said(payload.begin() + 3, payload.end());
      if (out.empty() || out.back() != said) out.push_back(std::move(said));
    }
    return out;
  }
  static std::vector<Bytes> expected(unsigned number, int updates) {
    RobotBody body(1, number);
    std::vector<Bytes> out{body.introduction()};
    for (int i = 0; i < updates; ++i) out.push_back(body.next_update());
    return out;
  }
  static BleOptions options(std::uint64_t messages) {
    BleOptions out;
    out.common.messages = messages;
    return out;
  }

  TimePoint now_{seconds{1000}};
  std::optional<Network> network_;
  std::map<Address, std::vector<Bytes>> heard_;
  bool acknowledges_ = false;
  std::uint8_t last_ttl_ = 0;
};

TEST_F(NetworkTest, IsSilentUntilTheHostHasSetUpTheBoard) {
  begin(options(10));
  run(seconds{30});
  EXPECT_TRUE(heard_.empty());
  EXPECT_EQ(network_->robots()[0].tally().sent, 0U);
}

TEST_F(NetworkTest, CarriesEveryUpdateInOrder) {
  begin(options(50));
  set_up();
  run(seconds{60});
  EXPECT_TRUE(network_->has_sent_everything());
  for (unsigned number = 1; number <= 3; ++number) {
    EXPECT_EQ(said_by(static_cast<Address>(0x00ff + number)), expected(number, 50));
  }
}

TEST_F(NetworkTest, CountsUpdatesLostOnAir) {
  BleOptions lossy = options(200);
  lossy.common.loss = 0.1;
  begin(lossy);
  set_up();
  run(seconds{120});
  std::uint64_t heard_updates = 0;
  std::uint64_t lost = 0;
  for (const auto& [source, payloads] : heard_) {
    for (const Bytes& payload : payloads) heard_updates += payload[0] == 0xcb ? 1 : 0;
  }
  for (const Robot& robot : network_->robots()) lost += robot.tally().lost;
  EXPECT_EQ(heard_updates + lost, 600U);
  EXPECT_NEAR(static_cast<double>(lost), 60, 30);
}

TEST_F(NetworkTest, LossesOfTheHopsAddToTheLoss) {
  BleOptions lossy = options(50);
  lossy.common.loss = 1;
  lossy.common.hop.loss = {0.1};
  begin(lossy);
  set_up();
  run(seconds{60});
  EXPECT_TRUE(heard_.empty());
  for (const Robot& robot : network_->robots()) EXPECT_EQ(robot.tally().lost, 50U);
}

TEST_F(NetworkTest, RepeatsRepairLossesWhenAcknowledged) {
  BleOptions lossy = options(50);
  lossy.common.loss = 0.2;
  lossy.is_acknowledged = true;
  acknowledges_ = true;
  begin(lossy);
  set_up();
  run(seconds{600});
  ASSERT_TRUE(network_->has_sent_everything());
  for (unsigned number = 1; number <= 3; ++number) {
    EXPECT_EQ(said_by(static_cast<Address>(0x00ff + number)), expected(number, 50));
    EXPECT_EQ(network_->robots()[number - 1].tally(), (Tally{50, 50, 0, 0}));
  }
}

TEST_F(NetworkTest, DecrementsTtlForEachRelay) {
  BleOptions far = options(1);
  far.hops = 3;
  begin(far);
  set_up();
  run(seconds{5});
  EXPECT_EQ(last_ttl_, default_ttl - 2);
}

TEST_F(NetworkTest, PublishesToGatewaysAddressOnRequest) {
  BleOptions unicast = options(5);
  unicast.is_unicast = true;
  begin(unicast);
  set_up();
  run(seconds{5});
  EXPECT_EQ(said_by(0x0101), expected(2, 5));
}

TEST_F(NetworkTest, WaitsForAHostEvenWhenConfigured) {
  BleOptions configured = options(5);
  configured.is_configured = true;
  configured.net_key = Bytes(16, 1);
  configured.app_key = Bytes(16, 2);
  begin(configured);
  run(seconds{5});
  EXPECT_TRUE(heard_.empty());
  tell("01 a8");
  run(seconds{5});
  EXPECT_EQ(said_by(0x0100), expected(1, 5));
}

TEST_F(NetworkTest, LosesNothingToReplayProtectionWhenMessagesAreOfManyKinds) {
  BleOptions busy = options(200);
  busy.common.rate_hz = 50;
  begin(busy);
  set_up();
  for (int i = 0; i < 400; ++i) {
    tell("12 ab 00 00 01 00 02 00 04 00 00 00 cd 59 00 0a 00 ec ff");  // answered at once
    run(milliseconds{13});
    now_ += milliseconds{13};
  }
  run(seconds{10});
  ASSERT_TRUE(network_->has_sent_everything());
  EXPECT_EQ(std::count_if(heard_[0x0100].begin(), heard_[0x0100].end(),
                          [](const Bytes& payload) { return payload[0] == 0xcb; }),
            200);
}

TEST_F(NetworkTest, RobotsContinueAfterBoardRestarts) {
  begin(options(50));
  set_up();
  run(seconds{3});
  network_->reboot_board(now_, seconds{2});
  run(seconds{3});
  set_up();  // the board has forgotten everything
  run(seconds{60});
  EXPECT_TRUE(network_->has_sent_everything());
  const std::vector<Bytes> said = said_by(0x0100);
  EXPECT_GE(said.size(), 50U);  // except for updates in flight
  EXPECT_EQ(said.back(), expected(1, 50).back());
}

TEST_F(NetworkTest, LosesOnEachHop) {
  BleOptions lossy = options(300);
  lossy.common.loss = 0.1;
  lossy.hops = 4;
  begin(lossy);
  set_up();
  run(seconds{120});
  std::uint64_t lost = 0;
  for (const Robot& robot : network_->robots()) lost += robot.tally().lost;
  EXPECT_NEAR(static_cast<double>(lost), 900 * (1 - 0.9 * 0.9 * 0.9 * 0.9), 60);
}

TEST_F(NetworkTest, ReportsHeartbeatsOnRequest) {
  BleOptions beating = options(1);
  beating.firmware = &firmware_5_0_0;
  beating.has_heartbeats = true;
  beating.hops = 3;
  begin(beating);
  set_up();
  const TimePoint end = now_ + seconds{25};
  int heartbeats = 0;
  while (network_->deadline() <= end) {
    now_ = std::max(now_, network_->deadline());
    network_->on_deadline(now_);
    while (auto packet = network_->next_host_packet(now_)) {
      if ((*packet)[1] != 0xd8) continue;
      EXPECT_EQ(to_hex(*packet).substr(0, 17), "07 d8 04 03 01 00");
      ++heartbeats;
    }
  }
  EXPECT_EQ(heartbeats, 6);
}

TEST_F(NetworkTest, DeliversCommandsToTheRobot) {
  begin(options(0));
  set_up();
  tell("12 ab 00 00 01 00 03 00 04 00 00 00 cd 59 00 0a 00 ec ff");
  run(milliseconds{100});
  EXPECT_EQ(network_->robots()[1].tally().commands_received, 1U);
  EXPECT_EQ(to_hex(heard_[0x0101].at(0)), "d0 59 00 00");
}

}  // namespace
}  // namespace slamgw::sim::ble
