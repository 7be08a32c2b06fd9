// SPDX-License-Identifier: Apache-2.0
// The serial board beyond the transcripts: incomplete frames, radio, resets, the transmit buffer.
#include "simulation/ble/board/board.hpp"

#include <gtest/gtest.h>

#include <string>

#include "tests/simulation/hex.hpp"

namespace slamgw::sim::ble {
namespace {

using std::chrono::microseconds;
using std::chrono::milliseconds;
using std::chrono::seconds;

const char* const cmd_subnet_add = "13 92 00 00 00 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d 0e 0f";
const char* const cmd_appkey_add =
    "15 97 00 00 00 00 10 11 12 13 14 15 16 17 18 19 1a 1b 1c 1d 1e 1f";

class BoardTest : public ::testing::Test {
 protected:
  explicit BoardTest(BoardStorage storage = BoardStorage::none, Duration octet_time = {})
      : board_(firmware_3_1_0, storage, Random(1, 0, Random::Use::provisioning), octet_time) {
    board_.on_power_up();
    drain();
  }

  /// Returns the board's answer to these bytes, packets separated by " | ".
  std::string exchange(std::string_view bytes) { return exchange(hex(bytes)); }
  std::string exchange(const Bytes& bytes) {
    board_.on_host_bytes(bytes, now_);
    return drain();
  }
  std::string drain() {
    std::string out;
    while (auto packet = board_.next_host_packet(now_)) {
      out += (out.empty() ? "" : " | ") + to_hex(*packet);
    }
    return out;
  }
  std::string pass(Duration time) {
    now_ += time;
    board_.on_deadline(now_);
    return drain();
  }
  /// Sets keys, address 0x0001, 0xc002-0xc004 as handles 0-2, robot 0x0100 as handle 3.
  void set_up() {
    for (const char* command : {cmd_subnet_add, cmd_appkey_add, "05 9f 01 00 01 00", "03 a1 02 c0",
                                "03 a1 03 c0", "03 a1 04 c0", "03 a4 00 01"}) {
      exchange(command);
    }
  }
  /// Returns a key of increasing octets from `first` on.
  static Key key_of(std::uint8_t first) {
    Key key{};
    for (std::uint8_t& octet : key) octet = first++;
    return key;
  }
  void receive(Address source, Address destination, std::string_view payload) {
    board_.on_radio({{source, destination, 8, hex(payload), ++sequence_}, 8, -60});
  }

  TimePoint now_{seconds{1000}};
  std::uint32_t sequence_ = 0;
  std::uint32_t sequence_of_next_message();

  Board board_;
};

/// The differences of a board that is built with storage.
class StoringBoardTest : public BoardTest {
 protected:
  StoringBoardTest() : BoardTest(BoardStorage::flash) {}
};

TEST_F(BoardTest, ReportsItsStart) {
  Board fresh{firmware_3_1_0, BoardStorage::none, Random(1, 0, Random::Use::provisioning)};
  fresh.on_power_up();
  EXPECT_EQ(to_hex(*fresh.next_host_packet(now_)), "04 81 02 00 fe");
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

TEST_F(BoardTest, ReadsModemManagersProbeAsStartOfPacket) {
  EXPECT_EQ(exchange("41 54 0d"), "");
  EXPECT_EQ(exchange("01 09"), "");
  EXPECT_EQ(exchange(Bytes(61, 0x00)), "03 84 54 84");  // executed as UUID Get of a wrong length
  EXPECT_EQ(exchange("03 02 68 69"), "03 82 68 69");
}

TEST_F(BoardTest, SynchronisesAfter255Zeros) {
  for (const char* torn : {"ff", "ff 02 41", "41 54 0d"}) {
    exchange(torn);
    exchange(Bytes(255, 0x00));
    EXPECT_EQ(exchange("03 02 68 69"), "03 82 68 69") << torn;
  }
}

TEST_F(BoardTest, SendsAndReportsTokenTwice) {
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

TEST_F(BoardTest, SendsNothingWhileItIsDisabled) {
  set_up();
  exchange("01 91");
  EXPECT_EQ(exchange("0e ab 00 00 01 00 03 00 08 00 00 00 cc 59 00"), "03 84 ab 83");
  EXPECT_FALSE(board_.next_transmission().has_value());
}

TEST_F(BoardTest, HearsVirtualAddresses) {
  set_up();
  receive(0x0100, 0x8985, "82 04 01");
  EXPECT_EQ(drain(), "");
  EXPECT_EQ(exchange("11 a2 40 41 42 43 44 45 46 47 48 49 4a 4b 4c 4d 4e 4f"), "05 84 a2 00 20 00");
  receive(0x0100, 0x8985, "82 04 01");
  EXPECT_EQ(drain(), "17 d1 00 01 20 00 00 00 00 00 08 01 00 01 f9 0b 6e c1 c4 03 00 82 04 01");
}

TEST_F(BoardTest, IgnoresGroupOfAllProxies) {
  set_up();
  exchange("03 a1 fc ff");
  receive(0x0100, 0xfffc, "82 04 01");
  EXPECT_EQ(drain(), "");
}

TEST_F(BoardTest, CannotSendWithADeviceKeyOfADeletedNetwork) {
  set_up();
  exchange("13 92 01 00 40 41 42 43 44 45 46 47 48 49 4a 4b 4c 4d 4e 4f");
  exchange("15 9c 00 01 01 00 30 31 32 33 34 35 36 37 38 39 3a 3b 3c 3d 3e 3f");
  exchange("03 94 01 00");
  EXPECT_EQ(exchange("0e ab 08 00 01 00 03 00 08 00 00 00 80 08 ff"), "03 84 ab 8e");
}

TEST_F(BoardTest, HearsBothKeysDuringAKeyRefresh) {
  set_up();
  const Encryption old_key{key_of(0x00), key_of(0x10), false};
  const Encryption new_key{key_of(0xa0), key_of(0x90), false};
  const auto is_heard = [&](const Encryption& with) {
    board_.on_radio({{0x0100, 0x0001, 8, hex("82 04 01"), ++sequence_, with}, 8, -60});
    return !drain().empty();
  };
  EXPECT_FALSE(is_heard(new_key));
  exchange("13 93 00 00 a0 a1 a2 a3 a4 a5 a6 a7 a8 a9 aa ab ac ad ae af");
  exchange("13 98 00 00 90 91 92 93 94 95 96 97 98 99 9a 9b 9c 9d 9e 9f");
  EXPECT_TRUE(is_heard(old_key));
  EXPECT_TRUE(is_heard(new_key));
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
  board_.on_transfer_ended(first, true);  // ended long ago
  EXPECT_EQ(exchange(segmented), "03 84 ab 83");
  board_.on_transfer_ended(*board_.next_transmission()->transfer, false);
  EXPECT_EQ(drain(), "");  // a failed transfer causes no event
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

TEST_F(BoardTest, DropsAndCountsEventsThatHostDoesNotRead) {
  set_up();
  for (int i = 0; i < 20; ++i) receive(0x0100, sensor_update_group, "cb 59 00 0a 00 ec ff 00");
  std::size_t octets = 0;
  int events = 0;
  while (auto packet = board_.next_host_packet(now_)) {
    octets += packet->size();
    ++events;
  }
  EXPECT_LE(octets, TransmitBuffer::capacity);
  EXPECT_EQ(exchange("01 14"),
            to_hex(Bytes{7, 0x84, 0x14, 0, static_cast<std::uint8_t>(20 - events), 0, 0, 0}));
  EXPECT_EQ(exchange("01 15"), "03 84 15 00");
  EXPECT_EQ(exchange("01 14"), "07 84 14 00 00 00 00 00");
}

/// Sends a short message to the robot 0x0100; returns its sequence number.
std::uint32_t BoardTest::sequence_of_next_message() {
  exchange("0e ab 00 00 01 00 03 00 08 00 00 00 cc 59 00");
  const auto transmission = board_.next_transmission();
  return transmission ? transmission->message.sequence : 0xffffffff;
}

TEST_F(BoardTest, ForgetsEverythingOnReset) {
  set_up();
  for (std::uint32_t i = 0; i < 3; ++i) EXPECT_EQ(sequence_of_next_message(), i);
  EXPECT_EQ(exchange("01 0e"), "");
  EXPECT_EQ(exchange("03 02 68 69"), "");  // still booting
  EXPECT_EQ(pass(Board::reboot_time), "04 81 02 00 fe");
  EXPECT_EQ(exchange("01 95"), "03 84 95 00");
  EXPECT_EQ(exchange("01 a0"), "07 84 a0 00 00 00 00 00");
  EXPECT_EQ(exchange("01 a8"), "03 84 a8 00");
  EXPECT_EQ(exchange("0e ab 00 00 01 00 03 00 08 00 00 00 cc 59 00"), "03 84 ab 8e");
  EXPECT_FALSE(board_.hears(sensor_update_group));
  set_up();
  EXPECT_EQ(sequence_of_next_message(), 0U);
}

/// With firmware 5.0.0 the host can set the sequence number of a board without storage.
TEST(HostKeptNumbers, ContinueFromNumberThatHostSets) {
  const TimePoint now{seconds{1000}};
  Board board{firmware_5_0_0, BoardStorage::none, Random(1, 0, Random::Use::provisioning)};
  board.on_power_up();
  const auto exchange = [&](std::string_view bytes) {
    while (board.next_host_packet(now)) {
    }
    board.on_host_bytes(hex(bytes), now);
    std::string out;
    while (auto packet = board.next_host_packet(now)) out += to_hex(*packet) + "|";
    return out;
  };
  for (const char* command : {cmd_subnet_add, cmd_appkey_add, "05 9f 01 00 01 00", "03 a4 00 01"})
    exchange(command);
  EXPECT_EQ(exchange("0c ae 05 00 00 00 00 00 00 00 40 00 00"),
            "08 d9 05 00 00 00 00 00 00|05 da 00 60 00 00|03 84 ae 00|");
  EXPECT_EQ(exchange("0c ae 05 00 00 00 00 00 00 00 40 00 00"), "03 84 ae 83|") << "once only";
  exchange("0e ab 00 00 01 00 00 00 08 00 00 00 cc 59 00");
  EXPECT_EQ(board.next_transmission()->message.sequence, 0x4000U);
  EXPECT_EQ(exchange("01 af"), "0e 84 af 00 00 00 00 00 00 00 00 00 60 00 00|");
}

TEST_F(BoardTest, RestartsWithoutEventWhenItsStartEventIsLost) {
  set_up();
  board_.reboot(now_, Board::reboot_time, StartEvent::lost);
  EXPECT_EQ(pass(Board::reboot_time), "");
  EXPECT_EQ(exchange("01 a0"), "07 84 a0 00 00 00 00 00");
  exchange("01 0e");
  EXPECT_EQ(pass(Board::reboot_time), "04 81 02 00 fe");
}

TEST_F(BoardTest, SendsFromAndHearsEachAddressOfItsRange) {
  for (const char* command : {cmd_subnet_add, cmd_appkey_add, "03 a1 02 c0", "03 a1 03 c0",
                              "03 a1 04 c0", "03 a4 00 01", "05 9f 01 00 40 00"}) {
    exchange(command);
  }
  EXPECT_EQ(exchange("01 a0"), "07 84 a0 00 01 00 40 00");
  EXPECT_EQ(exchange("0e ab 00 00 40 00 03 00 08 00 00 00 cc 59 00"), "07 84 ab 00 01 00 00 00");
  EXPECT_EQ(board_.next_transmission()->message.source, 0x0040);
  EXPECT_EQ(exchange("0e ab 00 00 41 00 03 00 08 00 00 00 cc 59 00"), "03 84 ab 87");
  receive(0x0100, 0x0040, "82 04 01");
  EXPECT_EQ(drain(), "17 d0 00 01 40 00 00 00 00 00 08 01 00 01 f9 0b 6e c1 c4 03 00 82 04 01");
  receive(0x0100, 0x0041, "82 04 01");
  EXPECT_EQ(drain(), "");
}

/// A board at the end of a line of 115200 baud, as Nordic's example has it: 86.8 us an octet.
class SlowLineTest : public BoardTest {
 protected:
  SlowLineTest() : BoardTest(BoardStorage::none, Duration{seconds{10}} / 115200) {}

  /// Runs until the line is idle; returns the board's packets.
  std::string settle() {
    std::string out;
    while (board_.deadline()) {
      now_ = std::max(now_, *board_.deadline());
      const std::string said = pass({});
      out += (out.empty() || said.empty() ? "" : " | ") + said;
    }
    return out;
  }
};

TEST_F(SlowLineTest, DelaysOctetsInBothDirections) {
  settle();
  const TimePoint begin = now_;
  EXPECT_EQ(exchange("01 09"), "");
  EXPECT_EQ(settle(), "05 84 09 00 0a 00");
  EXPECT_EQ(std::chrono::round<microseconds>(now_ - begin), microseconds{694});  // 8 octets
}

TEST_F(SlowLineTest, DropsAndCountsEventsThatLineCannotCarry) {
  exchange(cmd_subnet_add);
  exchange(cmd_appkey_add);
  exchange("05 9f 01 00 01 00 03 a1 03 c0");
  settle();
  const auto hear = [&](int events, Duration between) {
    std::string said;
    for (int i = 0; i < events; ++i) {
      receive(0x0100, sensor_update_group, "cb 59 00 0a 00 ec ff 00");
      said += drain();  // as each host of the model does after each input
      said += pass(between);
    }
    said += settle();
    int heard = 0;
    for (auto at = said.find("1c d1"); at != std::string::npos; at = said.find("1c d1", at + 1))
      ++heard;
    return heard;
  };
  EXPECT_EQ(hear(100, milliseconds{3}), 100) << "29 octets take 2.5 ms";
  EXPECT_EQ(hear(100, milliseconds{0}), 14) << "36 octets each, with their headers";
  exchange("01 14");
  EXPECT_EQ(settle(), "07 84 14 00 56 00 00 00");
}

TEST_F(StoringBoardTest, ForgetsItsMemoryButNotItsTablesOnReset) {
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

TEST_F(StoringBoardTest, ContinuesWithNextBlockOfSequenceNumbers) {
  set_up();
  for (std::uint32_t i = 0; i < 3; ++i) EXPECT_EQ(sequence_of_next_message(), i);
  exchange("01 0e");
  pass(Board::reboot_time);
  EXPECT_EQ(sequence_of_next_message(), 8192U);
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
  EXPECT_EQ(exchange(cmd_subnet_add), "03 84 92 8e");  // not its own key
}

}  // namespace
}  // namespace slamgw::sim::ble
