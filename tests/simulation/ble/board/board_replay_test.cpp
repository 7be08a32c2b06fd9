// SPDX-License-Identifier: Apache-2.0
// The simulated board answers each recorded command as Nordic's firmware did, in every release.
#include <gtest/gtest.h>

#include "simulation/ble/board/board.hpp"
#include "tests/simulation/hex.hpp"
#include "tests/support/transcript.hpp"

namespace slamgw::sim::ble {
namespace {

using test::Exchange;
using test::RecordedPacket;
using test::Transcript;

/// A board whose radio, as the recording's, takes every message at once and loses none.
class ReplayedBoard {
 public:
  explicit ReplayedBoard(const std::string& release)
      : board_(*find_firmware(release), BoardStorage::none,
               Random(1, 0, Random::Use::provisioning)) {
    board_.on_power_up();
  }

  std::vector<Bytes> answers_to(const Bytes& command) {
    std::vector<Bytes> answers;
    // Like the recording's host, this one reads while it writes.
    for (const std::uint8_t octet : command) {
      board_.on_host_bytes(Bytes{octet}, now_);
      fetch(answers);
    }
    on_air.reset();
    while (const auto transmission = board_.next_transmission()) {
      on_air = transmission->message;
      if (transmission->transfer) board_.on_transfer_ended(*transmission->transfer, true);
    }
    fetch(answers);
    while (board_.deadline()) {
      now_ = *board_.deadline();
      board_.on_deadline(now_);
      fetch(answers);
    }
    return answers;
  }

  std::optional<MeshMessage> on_air;  ///< what the last command gave to the radio

 private:
  void fetch(std::vector<Bytes>& answers) {
    while (auto packet = board_.next_host_packet(now_)) answers.push_back(std::move(*packet));
  }

  TimePoint now_{std::chrono::seconds{1000}};
  Board board_;
};

std::string text(const std::vector<Bytes>& packets) {
  std::string out;
  for (const Bytes& packet : packets) out += "\n  " + to_hex(packet);
  return out;
}

std::string text(const std::vector<RecordedPacket>& packets) {
  std::string out;
  for (const RecordedPacket& packet : packets) out += "\n  " + packet.text();
  return out;
}

bool matches(const std::vector<RecordedPacket>& recorded, const std::vector<Bytes>& answers) {
  return std::equal(
      recorded.begin(), recorded.end(), answers.begin(), answers.end(),
      [](const RecordedPacket& packet, const Bytes& answer) { return packet.matches(answer); });
}

void expect_on_air(const Exchange& exchange, const std::optional<MeshMessage>& sent) {
  ASSERT_EQ(sent.has_value(), exchange.on_air.has_value()) << to_hex(exchange.command);
  if (!sent) return;
  const test::RecordedMessage message{sent->source, sent->destination, sent->ttl,
                                      sent->encryption->is_device_key, sent->payload};
  EXPECT_EQ(message, *exchange.on_air) << to_hex(exchange.command);
}

void replay_board(const Transcript& transcript, const std::string& release) {
  ReplayedBoard board(release);
  for (const Exchange& exchange : transcript.exchanges) {
    const std::vector<Bytes> answers = board.answers_to(exchange.command);
    EXPECT_TRUE(matches(exchange.answers, answers))
        << release << " " << transcript.name << ", line " << exchange.line << ": "
        << exchange.situation << "\n> " << to_hex(exchange.command) << "\nrecorded"
        << text(exchange.answers) << "\nsimulated" << text(answers);
    if (transcript.name == "board") expect_on_air(exchange, board.on_air);
  }
}

TEST(BoardReplay, StartsUpAsRecorded) {
  for (const std::string& release : test::releases_of("start_up.txt")) {
    replay_board(test::read_transcript("start_up.txt", "start_up", release), release);
  }
}

TEST(BoardReplay, AnswersEachCommandAsRecorded) {
  for (const std::string& release : test::releases_of("board.txt")) {
    replay_board(test::read_transcript("board.txt", "board", release), release);
  }
}

TEST(BoardReplay, AnswersInEachSituationAsRecorded) {
  for (const std::string& release : test::releases_of("situations.txt")) {
    for (const Transcript& transcript : test::read_transcripts("situations.txt", release)) {
      replay_board(transcript, release);
    }
  }
}

}  // namespace
}  // namespace slamgw::sim::ble
