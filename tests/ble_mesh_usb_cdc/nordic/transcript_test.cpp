// SPDX-License-Identifier: Apache-2.0
// The daemon's side of recorded transcripts: it writes the recorded commands octet by octet, and
// decodes every recorded packet of the board.
#include "tests/support/transcript.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <numeric>

#include "adapters/ble_mesh_usb_cdc/nordic/board_radio.hpp"
#include "tests/ble_mesh_usb_cdc/hex.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;
using test::Exchange;
using test::RecordedPacket;
using test::Transcript;

constexpr std::uint8_t echo_command = 0x02;
constexpr std::uint8_t send_command = 0xab;

MeshKeys recorded_keys() {
  MeshKeys keys;
  std::iota(keys.net_key.begin(), keys.net_key.end(), std::uint8_t{0x10});
  std::iota(keys.app_key.begin(), keys.app_key.end(), std::uint8_t{0x20});
  return keys;
}

/// Answers as recorded, one exchange after another; each write must be the recorded one.
class RecordedBoard {
 public:
  explicit RecordedBoard(Transcript transcript) : transcript_(std::move(transcript)) {}

  Bytes power_on() { return answer(transcript_.exchanges.front()); }
  Bytes on_bytes(const Bytes& written) {
    if (is_at_end()) {
      ADD_FAILURE() << "after the transcript: " << to_hex(written);
      return {};
    }
    const Exchange& exchange = transcript_.exchanges[next_++];
    SCOPED_TRACE(exchange.situation);
    if (written.size() > 1 && written[1] == echo_command) {  // with another nonce
      EXPECT_EQ(written.size(), exchange.command.size());
      Bytes reply = written;
      reply[1] = 0x82;
      return reply;
    }
    EXPECT_EQ(to_hex(written), to_hex(exchange.command));
    return answer(exchange);
  }
  bool is_at_end() const { return next_ == transcript_.exchanges.size(); }

 private:
  static Bytes answer(const Exchange& exchange) {
    Bytes all;
    for (const RecordedPacket& packet : exchange.answers) all = all + packet.octets;
    return all;
  }

  Transcript transcript_;
  std::size_t next_ = 1;  // after power on
};

/// A radio and the board that it talks to, on one virtual clock.
struct RecordedRadio {
  explicit RecordedRadio(const std::string& release)
      : board(test::read_transcript("start_up.txt", "start_up", release)),
        radio(Settings{}, NodeDatabase{.keys = recorded_keys()}, {}, 1) {}

  void drain() {
    while (auto action = radio.next_action(now)) {
      if (const auto* write = std::get_if<WriteSerial>(&*action)) {
        written.push_back(write->bytes);
        if (is_replaying) radio.on_bytes(board.on_bytes(write->bytes), now);
      } else if (const auto* event = std::get_if<RadioEvent>(&*action)) {
        on_event(*event);
      }
    }
  }
  void on_event(const RadioEvent& event) {
    if (std::holds_alternative<ProvisionerEvent>(event)) {
      radio.use_source(1, 1, now);
    } else if (const auto* down = std::get_if<LinkIsDown>(&event)) {
      ADD_FAILURE() << down->why;
    } else if (const auto* up = std::get_if<LinkIsUp>(&event)) {
      detail = up->detail;
    }
  }
  void start() {
    radio.on_port_open(now);
    drain();
    while (!board.is_at_end() && now < TimePoint{} + 10s) {
      now += 10ms;
      radio.on_deadline(now);
      drain();
    }
    is_replaying = false;
  }
  std::uint64_t counter(std::string_view name) const {
    for (const auto& [each, value] : radio.counters())
      if (each == name) return value;
    ADD_FAILURE() << name;
    return 0;
  }

  RecordedBoard board;
  BoardRadio radio;
  TimePoint now{};
  std::string detail;
  std::vector<Bytes> written;
  bool is_replaying = true;
};

TEST(Transcript, AFreshBoardOfEachReleaseComesUp) {
  for (const std::string& release : test::releases_of("start_up.txt")) {
    SCOPED_TRACE(release);
    RecordedRadio recorded(release);
    recorded.start();
    EXPECT_NE(recorded.detail, "");
    EXPECT_EQ(recorded.counter("malformed_events"), 0u);
    EXPECT_EQ(recorded.counter("command_timeouts"), 0u);
    EXPECT_EQ(recorded.counter("resyncs"), 1u);
  }
}

TEST(Transcript, StatusNamesTheReleaseOfTheFirmware) {
  RecordedRadio old("2.2.0");
  old.start();
  EXPECT_EQ(old.detail.find("serial protocol version 8 (nRF5 SDK for Mesh 2.2), board UUID "), 0u)
      << old.detail;
  RecordedRadio recent("5.0.0");
  recent.start();
  EXPECT_NE(recent.detail.find("version 10 (nRF5 SDK for Mesh 3.1 to 5.0)"), std::string::npos);
}

TEST(Transcript, AMessageReachesTheRadioOfEachReleaseUnchanged) {
  for (const std::string& release : test::releases_of("start_up.txt")) {
    SCOPED_TRACE(release);
    RecordedRadio recorded(release);
    recorded.start();
    recorded.radio.send({0x0100, std::nullopt, hex("cc 59 00"), false}, recorded.now);
    recorded.drain();
    ASSERT_EQ(to_hex(recorded.written.back()), "03a40001");
    recorded.radio.on_bytes(hex("05 84 a4 00 03 00"), recorded.now);
    recorded.drain();
    EXPECT_EQ(to_hex(recorded.written.back()), release == "2.2.0"
                                                   ? "0dab000001000300040000cc5900"
                                                   : "0eab00000100030004000000cc5900");
  }
}

/// The recorded Packet Sends that put a message on air, without those that ask for segments or a
/// long TransMIC.
std::vector<Exchange> recorded_sends(const std::string& release, std::size_t options) {
  std::vector<Exchange> sends;
  for (const Exchange& exchange : test::read_transcript("board.txt", "board", release).exchanges) {
    if (exchange.command.size() < 2 || exchange.command[1] != send_command || !exchange.on_air)
      continue;
    const auto first = exchange.command.begin() + 9;
    if (std::all_of(first, first + static_cast<std::ptrdiff_t>(options),
                    [](std::uint8_t octet) { return octet == 0; }))
      sends.push_back(exchange);
  }
  return sends;
}

void expect_sends(const std::string& release, SerialVersion version, std::size_t options) {
  SCOPED_TRACE(release);
  const std::vector<Exchange> sends = recorded_sends(release, options);
  EXPECT_GE(sends.size(), 8u);
  for (const Exchange& exchange : sends) {
    SCOPED_TRACE(exchange.situation);
    ByteReader command(ByteView(exchange.command).subspan(2));
    PacketSend packet;
    packet.appkey_handle = command.read_u16_le();
    packet.source = exchange.on_air->source;
    command.read_u16_le();
    packet.destination_handle = command.read_u16_le();
    packet.ttl = exchange.on_air->ttl;
    packet.payload = exchange.on_air->payload;
    EXPECT_EQ(to_hex(encode_packet_send(packet, version)), to_hex(exchange.command));
  }
}

TEST(Transcript, EncodesPacketSendForEachRelease) {
  expect_sends("2.2.0", SerialVersion::sdk_2_2, 2);
  expect_sends("3.1.0", SerialVersion::sdk_3_1, 3);
  expect_sends("5.0.0", SerialVersion::sdk_3_1, 3);
}

TEST(Transcript, DecodesEveryRecordedPacket) {
  std::size_t packets = 0;
  for (const char* file : {"start_up.txt", "board.txt", "provisioning.txt", "situations.txt",
                           "configuration.txt", "life.txt"}) {
    for (const std::string& release : test::releases_of(file)) {
      for (const Transcript& transcript : test::read_transcripts(file, release)) {
        for (const Exchange& exchange : transcript.exchanges) {
          for (const RecordedPacket& packet : exchange.answers) {
            const auto event = decode_event(ByteView(packet.octets).subspan(1));
            EXPECT_TRUE(event.has_value()) << file << ':' << exchange.line << ' ' << packet.text();
            ++packets;
          }
        }
      }
    }
  }
  EXPECT_GT(packets, 2000u);
}

}  // namespace
}  // namespace slamgw::ble
