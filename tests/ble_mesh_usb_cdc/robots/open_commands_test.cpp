// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/robots/command_queue.hpp"

#include <gtest/gtest.h>

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;

const Now start{TimePoint{} + 100s, WallTime{} + 1000s};

TEST(OpenCommands, AreReadAsTheyWereWritten) {
  const std::vector<OpenCommand> commands{{"nr \"1\"", "cmd", start.mono - 5s, true},
                                          {"æøå", "x", start.mono, false}};
  EXPECT_EQ(decode_open_commands(encode_open_commands(commands, start), start), commands);
  EXPECT_EQ(decode_open_commands(encode_open_commands({}, start), start),
            std::vector<OpenCommand>());
}

TEST(OpenCommands, AreWrittenAsTheDocumentSays) {
  EXPECT_EQ(encode_open_commands({{"nr1", "cmd", start.mono - 5s, true}}, start),
            "[{\"robot\":\"nr1\",\"type\":\"cmd\",\"arrived_ms\":995000,\"sent\":true}]\n");
}

TEST(OpenCommands, GrowOlderWhileTheHostIsOff) {
  const std::string text = encode_open_commands({{"nr1", "cmd", start.mono, true}}, start);
  const Now later{TimePoint{} + 3s, start.wall + 60s};  // another life of the monotonic clock
  const auto read = decode_open_commands(text, later);
  ASSERT_TRUE(read);
  EXPECT_EQ(outcome_after_restart(read->at(0), later.mono).after, 60s);
  const Now set_back{TimePoint{} + 3s, start.wall - 60s};
  EXPECT_EQ(decode_open_commands(text, set_back)->at(0).arrived, set_back.mono);
}

TEST(OpenCommands, TheRestOfALongerLineIsIgnored) {
  const std::string line = encode_open_commands({{"nr1", "cmd", start.mono, true}}, start);
  EXPECT_EQ(decode_open_commands(line + "ent\":true}]\n", start)->size(), 1u);
}

TEST(OpenCommands, ADamagedLineIsNoList) {
  const std::string line = encode_open_commands({{"nr1", "cmd", start.mono, true}}, start);
  for (std::size_t size = 0; size < line.size(); ++size)
    EXPECT_FALSE(decode_open_commands(line.substr(0, size), start)) << size;
  for (const char* text : {"{}\n", "[1]\n", "[{}]\n",
                           "[{\"robot\":1,\"type\":\"x\",\"arrived_ms\":1,\"sent\":true}]\n",
                           "[{\"robot\":\"r\",\"type\":\"x\",\"arrived_ms\":0.5,\"sent\":true}]\n"})
    EXPECT_FALSE(decode_open_commands(text, start)) << text;
}

}  // namespace
}  // namespace slamgw::ble
