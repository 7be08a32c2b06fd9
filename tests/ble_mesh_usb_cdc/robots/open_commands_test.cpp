// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/robots/command_queue.hpp"

#include <gtest/gtest.h>

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;

const Now start{TimePoint{} + 100s, WallTime{} + 1000s};

TEST(OpenCommands, AreReadAsTheyWereWritten) {
  const OpenCommands commands{{"cmd", start.mono - 5s, true}, {"æøå", start.mono, false}};
  EXPECT_EQ(decode_open_commands(encode_open_commands(commands, start), start), commands);
  EXPECT_TRUE(decode_open_commands({}, start).empty());
}

TEST(OpenCommands, GrowOlderWhileTheHostIsOff) {
  const Bytes octets = encode_open_commands({{"cmd", start.mono, true}}, start);
  const Now later{TimePoint{} + 3s, start.wall + 60s};  // the monotonic clock has restarted
  const auto read = decode_open_commands(octets, later);
  ASSERT_EQ(read.size(), 1u);
  EXPECT_EQ(outcome_after_restart("nr1", read[0], later.mono).after, 60s);
  const Now set_back{TimePoint{} + 3s, start.wall - 60s};
  EXPECT_EQ(decode_open_commands(octets, set_back).at(0).arrived, set_back.mono);
}

TEST(OpenCommands, AreReadUpToFirstDamage) {
  const OpenCommands commands{{"cmd", start.mono, true}, {"x", start.mono, false}};
  const Bytes octets = encode_open_commands(commands, start);
  const std::size_t first = encode_open_commands({commands[0]}, start).size();
  for (std::size_t size = 0; size < octets.size(); ++size)
    EXPECT_EQ(decode_open_commands(ByteView(octets).first(size), start).size(),
              size < first ? 0u : 1u);
  const Bytes nonsense(40, 0xff);
  EXPECT_TRUE(decode_open_commands(nonsense, start).empty());
}

}  // namespace
}  // namespace slamgw::ble
