// SPDX-License-Identifier: Apache-2.0
// The recorded transcripts can be read, and contain the content that other tests rely on.
#include "tests/support/transcript.hpp"

#include <gtest/gtest.h>

#include <algorithm>

#include "tests/simulation/hex.hpp"

namespace slamgw::test {
namespace {

std::string words(const Exchange& exchange) {
  std::string out = sim::to_hex(exchange.command);
  for (const RecordedPacket& packet : exchange.answers) out += " | " + packet.text();
  return out;
}

bool has(const Transcript& transcript, const std::string& exchange) {
  return std::any_of(transcript.exchanges.begin(), transcript.exchanges.end(),
                     [&](const Exchange& e) { return words(e) == exchange; });
}

TEST(Transcripts, ExistForEachRelease) {
  const std::vector<std::string> all{"2.2.0", "3.1.0", "5.0.0"};
  for (const char* file : {"start_up.txt", "board.txt", "provisioning.txt"}) {
    EXPECT_EQ(releases_of(file), all) << file;
    for (const std::string& release : all) {
      for (const Transcript& transcript : read_transcripts(file, release)) {
        EXPECT_EQ(words(transcript.exchanges.front()), " | 04 81 02 00 fe") << transcript.name;
        EXPECT_GT(transcript.exchanges.size(), 5u) << transcript.name;
      }
    }
  }
  EXPECT_EQ(read_transcripts("situations.txt", "3.1.0").size(), 31u);
  EXPECT_GT(read_transcript("configuration.txt", "configuration", "3.1.0").exchanges.size(), 175u);
  EXPECT_EQ(read_transcripts("life.txt", "3.1.0").size(), 2u);
  EXPECT_THROW(read_transcripts("life.txt", "5.0.0"), std::runtime_error);
  EXPECT_THROW(read_transcripts("no.txt", "5.0.0"), std::runtime_error);
}

TEST(Transcripts, DifferWhereTheReleasesDo) {
  const Transcript before = read_transcript("board.txt", "board", "2.2.0");
  const Transcript after = read_transcript("board.txt", "board", "3.1.0");
  EXPECT_TRUE(has(before, "01 09 | 05 84 09 00 08 00"));
  EXPECT_TRUE(has(after, "01 09 | 05 84 09 00 0a 00"));
  EXPECT_TRUE(has(before, "0d ab 00 00 01 00 08 00 08 00 00 cc 59 00 | 03 84 ab 00"));
  EXPECT_TRUE(
      has(after,
          "0e ab 00 00 01 00 08 00 08 00 00 00 cc 59 00 | 07 84 ab 00 02 00 00 00 | 05 d2 02 00 "
          "00 00"));
}

TEST(Transcripts, ExpandRepeatsAndMaskOctets) {
  const Transcript start_up = read_transcript("start_up.txt", "start_up", "5.0.0");
  EXPECT_EQ(start_up.exchanges[1].command.size(), 255u);
  EXPECT_EQ(start_up.exchanges[1].answers.size(), 255u);
  const auto uuid = std::find_if(start_up.exchanges.begin(), start_up.exchanges.end(),
                                 [](const Exchange& e) { return e.situation == "UUID Get."; });
  ASSERT_NE(uuid, start_up.exchanges.end());
  const RecordedPacket& answer = uuid->answers[0];
  EXPECT_TRUE(
      answer.matches(sim::hex("13 84 54 00 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d 0e 0f 10")));
  EXPECT_FALSE(
      answer.matches(sim::hex("13 84 54 01 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d 0e 0f 10")));
  EXPECT_FALSE(answer.matches(sim::hex("03 84 54 00")));
}

TEST(Transcripts, ContainMessagesOnAir) {
  const Transcript board = read_transcript("board.txt", "board", "2.2.0");
  const auto sent = std::find_if(board.exchanges.begin(), board.exchanges.end(),
                                 [](const Exchange& e) { return e.on_air.has_value(); });
  ASSERT_NE(sent, board.exchanges.end());
  EXPECT_EQ(*sent->on_air, (RecordedMessage{0x0001, 0x0100, 8, false, {0xcc, 0x59, 0x00}}));
}

/// The start-up was put together from exchanges that were recorded one by one.
TEST(Transcripts, ComposeTheStartUpOfRecordedExchanges) {
  for (const std::string& release : releases_of("start_up.txt")) {
    const Transcript board = read_transcript("board.txt", "board", release);
    for (const Exchange& exchange :
         read_transcript("start_up.txt", "start_up", release).exchanges) {
      const bool is_echo_or_zeros = exchange.command.size() > 9 && exchange.command[1] <= 0x02;
      if (is_echo_or_zeros || exchange.situation.starts_with("Local Unicast Set")) continue;
      EXPECT_TRUE(has(board, words(exchange))) << release << ": " << words(exchange);
    }
  }
}

}  // namespace
}  // namespace slamgw::test
