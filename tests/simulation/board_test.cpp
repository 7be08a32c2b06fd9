// SPDX-License-Identifier: Apache-2.0
// The serial board byte for byte: framing as measured on Nordic's code, tables, status codes.
#include "simulation/ble/board/board.hpp"

#include <gtest/gtest.h>

#include <string>

#include "tests/simulation/hex.hpp"

namespace slamgw::sim::ble {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

const char* const cmd_subnet_add = "13 92 00 00 00 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d 0e 0f";
const char* const cmd_appkey_add =
    "15 97 00 00 00 00 10 11 12 13 14 15 16 17 18 19 1a 1b 1c 1d 1e 1f";

class BoardTest : public ::testing::Test {
 protected:
  BoardTest() {
    board_.on_power_up(now_);
    drain();
  }

  /// What the board says to these bytes, packets separated by " | ".
  std::string exchange(std::string_view bytes) { return exchange(hex(bytes)); }
  std::string exchange(const Bytes& bytes) {
    board_.on_host_bytes(bytes, now_);
    return drain();
  }
  std::string drain() {
    std::string out;
    while (auto packet = board_.next_host_packet()) {
      out += (out.empty() ? "" : " | ") + to_hex(*packet);
    }
    return out;
  }
  std::string pass(Duration time) {
    now_ += time;
    board_.on_deadline(now_);
    return drain();
  }
  /// Keys, address 0x0001, 0xc002-0xc004 as handles 0-2, robot 0x0100 as handle 3.
  void set_up() {
    for (const char* command : {cmd_subnet_add, cmd_appkey_add, "05 9f 01 00 01 00", "03 a1 02 c0",
                                "03 a1 03 c0", "03 a1 04 c0", "03 a4 00 01"}) {
      exchange(command);
    }
  }
  void receive(Address source, Address destination, std::string_view payload) {
    board_.on_radio({{source, destination, 8, hex(payload), ++sequence_}, 8, -60});
  }

  TimePoint now_{seconds{1000}};
  std::uint32_t sequence_ = 0;
  Board board_{Random(1, 0, Random::Use::provisioning)};
};

TEST_F(BoardTest, SaysThatItStarted) {
  Board fresh{Random(1, 0, Random::Use::provisioning)};
  fresh.on_power_up(now_);
  EXPECT_EQ(to_hex(*fresh.next_host_packet()), "04 81 02 00 fe");
}

TEST_F(BoardTest, FramesAsMeasured) {
  EXPECT_EQ(exchange("03 02 68 69"), "03 82 68 69");
  EXPECT_EQ(exchange("00"), "03 84 00 84");
  EXPECT_EQ(exchange("00 03 02 68 69"), "03 84 00 84 | 03 82 68 69");
  EXPECT_EQ(exchange("05 02 61"), "");
  EXPECT_EQ(exchange("00 00 00"), "05 82 61 00 00 00");
  Bytes largest(256, 0x41);
  largest[0] = 0xff;
  largest[1] = 0x02;
  Bytes answer = largest;
  answer[1] = 0x82;
  EXPECT_EQ(exchange(largest), to_hex(answer));
}

TEST_F(BoardTest, SwallowsModemManagersProbeAndWhatFollows) {
  EXPECT_EQ(exchange("41 54 0d"), "");
  EXPECT_EQ(exchange("01 09"), "");
  EXPECT_EQ(exchange(Bytes(61, 0x00)), "03 84 54 84");  // executed as UUID Get of a wrong length
  EXPECT_EQ(exchange("03 02 68 69"), "03 82 68 69");
}

TEST_F(BoardTest, IsInStepAgainAfter255Zeros) {
  for (const char* torn : {"ff", "ff 02 41", "41 54 0d"}) {
    exchange(torn);
    exchange(Bytes(255, 0x00));
    EXPECT_EQ(exchange("03 02 68 69"), "03 82 68 69") << torn;
  }
}

TEST_F(BoardTest, TellsItsVersionAndRefusesTheUnknown) {
  EXPECT_EQ(exchange("01 09"), "05 84 09 00 0a 00");
  EXPECT_EQ(exchange("01 0a"), "03 84 0a 82");
  EXPECT_EQ(exchange("01 7f"), "03 84 7f 82");
  EXPECT_EQ(exchange("02 09 00"), "03 84 09 84");
  EXPECT_EQ(exchange("02 20 00"), "03 84 20 8e");
  EXPECT_EQ(exchange("01 54").substr(0, 11), "13 84 54 00");
}

TEST_F(BoardTest, IsSilentToUnknownProvisioningCommands) {
  for (const char* command : {"01 60", "01 65", "01 6b", "01 6f"}) EXPECT_EQ(exchange(command), "");
  EXPECT_EQ(exchange("01 61"), "03 84 61 00");
  EXPECT_EQ(exchange("01 61"), "03 84 61 83");
  EXPECT_EQ(exchange("01 62"), "03 84 62 00");
  EXPECT_EQ(exchange("01 62"), "03 84 62 83");
  EXPECT_EQ(exchange("05 66 07 00 00 00"), "03 84 66 87");
}

TEST_F(BoardTest, StartsTheMeshItself) {
  EXPECT_EQ(exchange("01 90"), "03 84 90 83");
  EXPECT_EQ(exchange("01 91"), "03 84 91 00");
  EXPECT_EQ(exchange("01 91"), "03 84 91 83");
  EXPECT_EQ(exchange("01 90"), "03 84 90 00");
}

TEST_F(BoardTest, KeepsSubnetsAndAppkeys) {
  EXPECT_EQ(exchange(cmd_appkey_add), "03 84 97 8e");  // no such subnet
  EXPECT_EQ(exchange(cmd_subnet_add), "05 84 92 00 00 00");
  EXPECT_EQ(exchange(cmd_subnet_add), "03 84 92 81");  // the same key again
  EXPECT_EQ(exchange("13 92 00 00 ff 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d 0e 0f"), "03 84 92 8e");
  EXPECT_EQ(exchange("12 92 00 00 00 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d 0e"), "03 84 92 84");
  EXPECT_EQ(exchange("01 95"), "05 84 95 00 00 00");
  EXPECT_EQ(exchange(cmd_appkey_add), "05 84 97 00 00 00");
  EXPECT_EQ(exchange(cmd_appkey_add), "03 84 97 81");
  EXPECT_EQ(exchange("03 9a 00 00"), "07 84 9a 00 00 00 00 00");
  EXPECT_EQ(exchange("03 9a 05 00"), "03 84 9a 8e");
  for (std::uint8_t index = 1; index <= 8; ++index) {
    Bytes add = hex(cmd_subnet_add);
    add[2] = index;
    const bool has_room = index < 8;
    EXPECT_EQ(exchange(add), has_room ? "05 84 92 00 0" + std::to_string(index) + " 00"
                                      : std::string("03 84 92 8e"));
  }
  EXPECT_EQ(exchange("01 96"), "05 84 96 00 08 00");
  EXPECT_EQ(exchange("01 9b"), "05 84 9b 00 08 00");
  EXPECT_EQ(exchange("03 94 00 00"), "05 84 94 00 00 00");
  EXPECT_EQ(exchange("03 9a 00 00"), "03 84 9a 8e");
}

TEST_F(BoardTest, ListsNoApplicationKeysAsSuccessWithoutData) {
  exchange(cmd_subnet_add);
  EXPECT_EQ(exchange("03 9a 00 00"), "03 84 9a 00");
  exchange(cmd_appkey_add);
  EXPECT_EQ(exchange("03 9a 00 00"), "07 84 9a 00 00 00 00 00");
  EXPECT_EQ(exchange("03 99 00 00"), "05 84 99 00 00 00");
  EXPECT_EQ(exchange("03 9a 00 00"), "03 84 9a 00");
}

TEST_F(BoardTest, CountsDevkeyHandlesFromEight) {
  exchange(cmd_subnet_add);
  Bytes add = hex("15 9c 00 01 00 00 00 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d 0e 0f");
  EXPECT_EQ(exchange(add), "05 84 9c 00 08 00");
  EXPECT_EQ(exchange(add), "03 84 9c 8e");  // the same key again, too
  for (std::uint8_t i = 1; i < 10; ++i) {
    add[2] = i;
    EXPECT_EQ(exchange(add).substr(0, 11), "05 84 9c 00");
  }
  add[2] = 10;
  EXPECT_EQ(exchange(add), "03 84 9c 8e");
  EXPECT_EQ(exchange("03 9d 09 00"), "05 84 9d 00 09 00");
  EXPECT_EQ(exchange("03 9d 09 00"), "03 84 9d 8e");
  EXPECT_EQ(exchange("01 9e"), "05 84 9e 00 0a 00");
}

TEST_F(BoardTest, TakesItsAddressOnce) {
  EXPECT_EQ(exchange("01 a0"), "07 84 a0 00 00 00 00 00");
  EXPECT_EQ(exchange("05 9f 00 00 01 00"), "03 84 9f 85");
  EXPECT_EQ(exchange("05 9f 01 00 01 00"), "03 84 9f 00");
  EXPECT_EQ(exchange("05 9f 01 00 01 00"), "03 84 9f 8e");
  EXPECT_EQ(exchange("01 a0"), "07 84 a0 00 01 00 01 00");
  EXPECT_EQ(exchange("01 ac"), "03 84 ac 00");
  EXPECT_EQ(exchange("01 a0"), "07 84 a0 00 00 00 00 00");
}

TEST_F(BoardTest, KeepsAddressesByHandle) {
  EXPECT_EQ(exchange("03 a1 02 c0"), "05 84 a1 00 00 00");
  EXPECT_EQ(exchange("03 a1 03 c0"), "05 84 a1 00 01 00");
  EXPECT_EQ(exchange("03 a1 02 c0"), "05 84 a1 00 00 00");  // counted, the same handle
  EXPECT_EQ(exchange("03 a4 00 01"), "05 84 a4 00 02 00");
  EXPECT_EQ(exchange("03 a1 00 01"), "03 84 a1 85");
  EXPECT_EQ(exchange("03 a4 00 80"), "03 84 a4 85");
  EXPECT_EQ(exchange("03 a7 01 00"), "09 84 a7 00 01 00 03 01 03 c0");
  EXPECT_EQ(exchange("03 a7 02 00"), "09 84 a7 00 02 00 01 00 00 01");
  EXPECT_EQ(exchange("01 a8"), "09 84 a8 00 00 00 01 00 02 00");
  EXPECT_EQ(exchange("03 a6 02 00"), "05 84 a6 00 02 00");
  EXPECT_EQ(exchange("03 a6 02 00"), "03 84 a6 8e");
  EXPECT_EQ(exchange("03 a7 02 00"), "03 84 a7 8e");
  EXPECT_EQ(exchange("03 a3 00 00"), "05 84 a3 00 00 00");
  EXPECT_EQ(exchange("03 a7 00 00"), "09 84 a7 00 00 00 03 01 02 c0");  // still counted once
  for (int i = 0; i < 30; ++i) exchange(Bytes{3, 0xa4, static_cast<std::uint8_t>(i), 0x02});
  EXPECT_EQ(exchange("03 a4 ff 02"), "03 84 a4 8e");
  EXPECT_EQ(exchange("01 a9"), "05 84 a9 00 20 00");
}

TEST_F(BoardTest, SendsAndTellsTheTokenTwice) {
  set_up();
  const char* send = "12 ab 00 00 01 00 03 00 08 00 00 00 cd 59 00 0a 00 ec ff";
  EXPECT_EQ(exchange(send), "07 84 ab 00 01 00 00 00");
  const MeshMessage message = board_.next_transmission()->message;
  EXPECT_EQ(message.source, 0x0001);
  EXPECT_EQ(message.destination, 0x0100);
  EXPECT_EQ(message.ttl, 8);
  EXPECT_EQ(to_hex(message.payload), "cd 59 00 0a 00 ec ff");
  EXPECT_EQ(pass(milliseconds{10}), "05 d2 01 00 00 00");
}

TEST_F(BoardTest, RefusesToSendWhatItCannot) {
  set_up();
  EXPECT_EQ(exchange("0e ab 00 00 02 00 03 00 08 00 00 00 cc 59 00"), "03 84 ab 87");  // source
  EXPECT_EQ(exchange("0e ab 00 00 01 00 09 00 08 00 00 00 cc 59 00"), "03 84 ab 8e");  // address
  EXPECT_EQ(exchange("0e ab 05 00 01 00 03 00 08 00 00 00 cc 59 00"), "03 84 ab 8e");  // key
  EXPECT_EQ(exchange("0e ab 00 00 01 00 03 00 80 00 00 00 cc 59 00"), "03 84 ab 85");  // TTL
  EXPECT_EQ(exchange("0a ab 00 00 01 00 03 00 08 00 00"), "03 84 ab 84");
  exchange("01 91");
  EXPECT_EQ(exchange("0e ab 00 00 01 00 03 00 08 00 00 00 cc 59 00"), "03 84 ab 83");
  EXPECT_FALSE(board_.next_transmission().has_value());
}

TEST_F(BoardTest, SendsOneSegmentedMessageToADestinationAtATime) {
  set_up();
  const char* segmented = "17 ab 00 00 01 00 03 00 08 00 00 00 c5 59 00 01 02 03 04 05 06 07 08 09";
  EXPECT_EQ(exchange(segmented), "07 84 ab 00 01 00 00 00");
  EXPECT_EQ(exchange(segmented), "03 84 ab 83");
  const std::uint64_t first = *board_.next_transmission()->transfer;
  board_.on_transfer_ended(first, true);
  EXPECT_EQ(drain(), "05 d2 01 00 00 00");
  EXPECT_EQ(exchange(segmented), "07 84 ab 00 03 00 00 00");
  board_.on_transfer_ended(first, true);  // long over
  EXPECT_EQ(exchange(segmented), "03 84 ab 83");
  board_.on_transfer_ended(*board_.next_transmission()->transfer, false);
  EXPECT_EQ(drain(), "");  // a failure shows by what does not come
  EXPECT_EQ(exchange(segmented), "07 84 ab 00 05 00 00 00");
}

TEST_F(BoardTest, ReportsGroupMessagesByHandleAndItsOwnByAddress) {
  set_up();
  receive(0x0100, sensor_update_group, "c9 59 00 0a 00 ec ff 64 00 2c 01 00");
  EXPECT_EQ(drain(),
            "20 d1 00 01 01 00 00 00 00 00 08 01 00 01 f9 0b 6e c1 c4 0c 00 c9 59 00 0a 00 ec ff "
            "64 00 2c 01 00");
  receive(0x0100, 0x0001, "82 04 01");
  EXPECT_EQ(drain(), "17 d0 00 01 01 00 00 00 00 00 08 01 00 01 f9 0b 6e c1 c4 03 00 82 04 01");
  receive(0x0100, 0xc00f, "82 04 01");
  receive(0x0100, 0x0002, "82 04 01");
  EXPECT_EQ(drain(), "");
}

TEST_F(BoardTest, HearsNothingWithoutKeyOrWhileDisabled) {
  exchange("03 a1 03 c0");
  EXPECT_FALSE(board_.hears(sensor_update_group));
  exchange(cmd_subnet_add);
  exchange(cmd_appkey_add);
  EXPECT_TRUE(board_.hears(sensor_update_group));
  EXPECT_FALSE(board_.is_ready_for(sensor_update_group, now_));
  EXPECT_TRUE(board_.is_ready_for(sensor_update_group, now_ + milliseconds{500}));
  exchange("01 91");
  EXPECT_FALSE(board_.hears(sensor_update_group));
}

TEST_F(BoardTest, DropsSilentlyWhenNobodyReadsAndCountsIt) {
  set_up();
  for (int i = 0; i < 20; ++i) receive(0x0100, sensor_update_group, "cb 59 00 0a 00 ec ff 00");
  std::size_t octets = 0;
  int events = 0;
  while (auto packet = board_.next_host_packet()) {
    octets += packet->size();
    ++events;
  }
  EXPECT_LE(octets, Board::transmit_buffer);
  EXPECT_EQ(exchange("01 14"),
            to_hex(Bytes{7, 0x84, 0x14, 0, static_cast<std::uint8_t>(20 - events), 0, 0, 0}));
  EXPECT_EQ(exchange("01 15"), "03 84 15 00");
  EXPECT_EQ(exchange("01 14"), "07 84 14 00 00 00 00 00");
}

TEST_F(BoardTest, ForgetsItsMemoryButNotItsTablesOnReset) {
  set_up();
  exchange("01 61");
  EXPECT_EQ(exchange("01 0e"), "");
  EXPECT_EQ(exchange("03 02 68 69"), "");  // still booting
  EXPECT_EQ(pass(Board::reboot_time), "04 81 02 00 fe");
  EXPECT_EQ(exchange("01 61"), "03 84 61 00");
  EXPECT_EQ(exchange("01 a0"), "07 84 a0 00 01 00 01 00");
  EXPECT_EQ(exchange("01 a8"), "0b 84 a8 00 00 00 01 00 02 00 03 00");
  EXPECT_TRUE(board_.hears(sensor_update_group));
}

TEST_F(BoardTest, HearsOnlyFortySources) {
  set_up();
  int heard = 0;
  for (Address source = 0x0100; source < 0x0100 + 45; ++source) {
    receive(source, sensor_update_group, "cb 59 00 0a 00 ec ff 00");
    if (!drain().empty()) ++heard;
  }
  EXPECT_EQ(heard, 40);
}

TEST_F(BoardTest, CanStartConfigured) {
  board_.configure(Key{1}, Key{2});
  EXPECT_EQ(exchange("01 a0"), "07 84 a0 00 01 00 01 00");
  EXPECT_EQ(exchange("01 a8"), "09 84 a8 00 00 00 01 00 02 00");
  EXPECT_EQ(exchange(cmd_subnet_add), "03 84 92 8e");  // another key than its own
}

}  // namespace
}  // namespace slamgw::sim::ble
