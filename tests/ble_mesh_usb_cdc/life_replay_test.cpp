// SPDX-License-Identifier: Apache-2.0
// The daemon's machine goes through the recorded life of a gateway, a board and a robot that run
// Nordic's code, octet by octet: start-up, scan, provisioning, configuration, updates and their
// STATUS, commands, removal. Runs for each release; where a release differs, its own recordings are
// used.
#include <gtest/gtest.h>

#include <algorithm>
#include <deque>
#include <numeric>

#include "adapters/ble_mesh_usb_cdc/ble_mesh.hpp"
#include "adapters/ble_mesh_usb_cdc/nordic/board_radio.hpp"
#include "tests/ble_mesh_usb_cdc/event_log.hpp"
#include "tests/ble_mesh_usb_cdc/hex.hpp"
#include "tests/support/transcript.hpp"

namespace slamgw::ble {
namespace {

using namespace std::chrono_literals;
using test::Exchange;
using test::RecordedPacket;
using test::Transcript;

constexpr std::uint8_t echo = 0x02;
constexpr std::uint8_t version_get = 0x09;
constexpr std::uint8_t housekeeping_get = 0x14;
constexpr std::uint8_t provision = 0x63;
constexpr std::uint8_t keypair_set = 0x69;
constexpr std::uint8_t subnet_add_command = 0x92;
constexpr std::uint8_t appkey_add_command = 0x97;
constexpr std::uint8_t devkey_add = 0x9c;
constexpr std::uint8_t local_unicast_set = 0x9f;
constexpr std::uint8_t local_unicast_get = 0xa0;
constexpr std::uint8_t packet_send = 0xab;
constexpr std::uint8_t tx_complete = 0xd2;
constexpr std::size_t message_in_send = 12;

std::uint8_t frame_opcode_of(const Bytes& frame) { return frame.size() > 1 ? frame[1] : 0; }

bool carries(const Bytes& frame, std::string_view access) {
  const Bytes wanted = hex(access);
  return frame_opcode_of(frame) == packet_send && frame.size() >= message_in_send + wanted.size() &&
         std::ranges::equal(ByteView(frame).subspan(message_in_send, wanted.size()), wanted);
}

Bytes message_of(const Bytes& frame) { return {frame.begin() + message_in_send, frame.end()}; }

Bytes with_message(const Bytes& frame, const Bytes& message) {
  Bytes changed(frame.begin(), frame.begin() + message_in_send);
  changed = changed + message;
  changed[0] = static_cast<std::uint8_t>(changed.size() - 1);
  return changed;
}

/// The recorded host set the groups of a model with Subscription Overwrite, which can stop a robot.
/// The daemon asks for the list and adds one group after the other, so each Overwrite becomes Get
/// and Add. The answers are those that the robot gave in configuration.txt; see
/// AnswersInPlaceOfOverwriteWereRecorded.
std::vector<Exchange> without_overwrite(const std::vector<Exchange>& recorded) {
  std::vector<Exchange> exchanges;
  for (const Exchange& exchange : recorded) {
    if (!carries(exchange.command, "80 1e")) {
      exchanges.push_back(exchange);
      continue;
    }
    const Bytes overwrite = message_of(exchange.command);
    const Bytes element(overwrite.begin() + 2, overwrite.begin() + 4);
    const Bytes model(overwrite.begin() + 6, overwrite.end());
    const bool is_vendor = model.size() == 4;
    Exchange get = exchange;
    get.command =
        with_message(exchange.command, hex(is_vendor ? "80 2b" : "80 29") + element + model);
    RecordedPacket& list = get.answers.back();
    const Bytes none = hex(is_vendor ? "80 2c 00" : "80 2a 00") + element + model;
    list.octets.resize(21);
    list.octets = list.octets + none;
    list.octets[19] = static_cast<std::uint8_t>(none.size());
    list.octets[0] = static_cast<std::uint8_t>(list.octets.size() - 1);
    list.is_defined.assign(list.octets.size(), true);
    exchanges.push_back(get);
    Exchange add = exchange;
    add.command[message_in_send + 1] = 0x1b;
    exchanges.push_back(add);
  }
  return exchanges;
}

/// The life was recorded with release 3.1.0. 5.0.0 has the same layouts; 2.2.0 has no attention
/// octet in Provision, no credentials octet in Packet Send, no token in its answer and no TX
/// Complete (ProvisioningReplay and transcript_test.cpp show each on its own recordings).
void turn_into(const std::string& release, Exchange& exchange) {
  if (frame_opcode_of(exchange.command) == version_get) {
    const Transcript start = test::read_transcript("start_up.txt", "start_up", release);
    for (const Exchange& each : start.exchanges)
      if (frame_opcode_of(each.command) == version_get) exchange.answers = each.answers;
  }
  if (release != "2.2.0") return;
  if (frame_opcode_of(exchange.command) == provision) exchange.command.pop_back();
  if (frame_opcode_of(exchange.command) == packet_send)
    exchange.command.erase(exchange.command.begin() + message_in_send - 1);
  if (frame_opcode_of(exchange.command) == provision ||
      frame_opcode_of(exchange.command) == packet_send)
    --exchange.command[0];
  std::erase_if(exchange.answers,
                [](const RecordedPacket& packet) { return packet.octets[1] == tx_complete; });
  for (RecordedPacket& packet : exchange.answers) {
    const bool has_token =
        packet.octets.size() == 8 && packet.octets[1] == 0x84 && packet.octets[2] == packet_send;
    if (!has_token) continue;
    packet.octets = hex("03 84 ab 00");
    packet.is_defined.assign(4, true);
  }
}

Transcript life(const std::string& name, const std::string& release) {
  Transcript transcript = test::read_transcript("life.txt", name, "3.1.0");
  transcript.exchanges = without_overwrite(transcript.exchanges);
  for (Exchange& exchange : transcript.exchanges) turn_into(release, exchange);
  return transcript;
}

template <std::size_t size>
std::array<std::uint8_t, size> octets_of(const Transcript& transcript, std::uint8_t opcode,
                                         std::size_t at) {
  std::array<std::uint8_t, size> octets{};
  for (const Exchange& exchange : transcript.exchanges)
    if (frame_opcode_of(exchange.command) == opcode)
      std::copy_n(exchange.command.begin() + static_cast<std::ptrdiff_t>(at), size, octets.begin());
  return octets;
}

/// The host's private keys, in their order.
RandomSource recorded_private_key(const Transcript& transcript) {
  return [key = octets_of<32>(transcript, keypair_set, 2)](std::span<std::uint8_t> octets) {
    if (octets.size() != key.size()) return false;
    std::ranges::copy(key, octets.begin());
    return true;
  };
}

/// The mesh on a BoardRadio in front of a recording: each command that it writes must be the
/// recorded one, and gets the recorded answers. Inside one situation the order is free, because the
/// answers do not depend on it. Actions of the recorded operator and server run in their turn.
class LifeReplay : public EventLog {
 public:
  LifeReplay(Transcript transcript, const Settings& settings)
      : transcript_(std::move(transcript)),
        keys_{octets_of<16>(transcript_, subnet_add_command, 4),
              octets_of<16>(transcript_, appkey_add_command, 6)},
        is_done_(transcript_.exchanges.size(), false),
        mesh(settings, TopicScheme("ntnu-slam", "gw"), RobotNames(), std::nullopt,
             std::make_unique<BoardRadio>(settings, std::nullopt, recorded_private_key(transcript_),
                                          7),
             [this, drawn = 0](std::span<std::uint8_t> octets) mutable {
               std::ranges::copy(drawn++ == 0 ? keys_.net_key : keys_.app_key, octets.begin());
               return true;
             }) {}

  void run() {
    mesh.on_start();
    is_done_[0] = true;  // power on
    mesh.on_port_open(now);
    settle();
    for (int idle = 0; next() != nullptr && idle < 200 && !has_failed_; ++idle) {
      if (act(*next())) idle = 0;
      now += 50ms;
      mesh.on_deadline(now);
      settle();
    }
    if (next() != nullptr && !has_failed_)
      ADD_FAILURE() << "line " << next()->line << " (" << next()->situation
                    << ") is not reached: " << to_hex(next()->command);
  }

 private:
  const Exchange* next() const {
    const auto found = std::ranges::find(is_done_, false);
    return found == is_done_.end()
               ? nullptr
               : &transcript_.exchanges[static_cast<std::size_t>(found - is_done_.begin())];
  }

  /// Plays events that the daemon does not cause.
  bool act(const Exchange& exchange) {
    const std::size_t at = static_cast<std::size_t>(&exchange - transcript_.exchanges.data());
    if (std::exchange(acted_at_, at) == at) return false;
    const auto command = [&](std::string_view type, Bytes payload) {
      mesh.on_broker_message({"ble-0100",
                              {"ntnu-slam/server/ble-0100/" + std::string(type), std::move(payload),
                               Qos::at_least_once, false},
                              CommandId{++last_command}},
                             now);
    };
    const Bytes message = without_layout(exchange.command);
    if (starts_with(message, "cd 59 00")) {
      command("cmd", {message.begin() + 3, message.end()});
    } else if (starts_with(message, "82 02")) {
      command("run", {static_cast<std::uint8_t>('0' + message[2])});
    } else if (starts_with(message, "c5 59 00")) {
      command("text", {message.begin() + 3, message.end()});
    } else if (exchange.situation.starts_with("Removal")) {
      mesh.on_order(1, RemoveOrder{"ble-0100", false}, now);
    } else {
      return false;
    }
    settle();
    return true;
  }
  static Bytes without_layout(const Bytes& frame) {
    if (frame_opcode_of(frame) != packet_send) return {};
    const std::size_t head = frame[0] + 1U == frame.size() && frame[11] == 0 ? 12 : 11;
    return {frame.begin() + static_cast<std::ptrdiff_t>(head), frame.end()};
  }
  static bool starts_with(const Bytes& bytes, std::string_view head) {
    const Bytes wanted = hex(head);
    return bytes.size() > wanted.size() && std::equal(wanted.begin(), wanted.end(), bytes.begin());
  }

  void settle() {
    while (true) {
      while (auto action = mesh.next_action()) perform(*action);
      if (from_board_.empty()) return;
      const Bytes packet = std::move(from_board_.front());
      from_board_.pop_front();
      now += 20ms;
      mesh.on_bytes(packet, now);
    }
  }

  void perform(MeshAction& action) {
    std::visit(overloaded{
                   [&](WriteSerial& write) { answer(write.bytes); },
                   [&](ReopenPort&) { ADD_FAILURE() << "the daemon closed the link"; },
                   [&](StoreMesh& store) {
                     stored = std::move(store.database);
                     mesh.on_stored({}, now);
                   },
                   [](HeardRobot&) {},
                   [&](OrderEnded& ended) { answers.push_back(std::move(ended.answer)); },
                   [&](MeshEvent& event) {
                     if (const auto* report = std::get_if<Report>(&event))
                       if (report->receipt.is_owed())
                         mesh.on_receipt(report->receipt.id, ReceiptOutcome::safe, now);
                     events.push_back(std::move(event));
                   },
               },
               action);
  }

  void answer(const Bytes& written) {
    if (has_failed_) return;
    if (frame_opcode_of(written) == housekeeping_get && mesh_is_started()) {  // each 10 s
      from_board_.push_back(hex("07 84 14 00 00 00 00 00"));
      return;
    }
    if (frame_opcode_of(written) == local_unicast_get && mesh_is_started()) {  // alternates with it
      from_board_.push_back(hex("07 84 a0 00 01 00 20 00"));
      return;
    }
    const Exchange* expected = next();
    if (expected == nullptr) return written_after_end.push_back(written);
    const std::string situation = expected->situation;
    for (std::size_t i = 0; i < is_done_.size(); ++i) {
      const Exchange& exchange = transcript_.exchanges[i];
      if (is_done_[i] || exchange.situation != situation || !is_same(exchange.command, written))
        continue;
      is_done_[i] = true;
      for (const RecordedPacket& packet : exchange.answers)
        from_board_.push_back(frame_opcode_of(written) == echo ? echoed(written) : packet.octets);
      return skip_polls();
    }
    has_failed_ = true;
    ADD_FAILURE() << "line " << expected->line << " (" << situation << ")\nrecorded "
                  << to_hex(expected->command) << "\nwritten  " << to_hex(written);
  }
  bool mesh_is_started() const { return !all<LinkChange>().empty(); }
  /// Skips recorded polls, whose time depends on the clock, and plays the robot messages in them.
  void skip_polls() {
    while (next() != nullptr && mesh_is_started() &&
           frame_opcode_of(next()->command) == housekeeping_get) {
      const std::size_t at = static_cast<std::size_t>(next() - transcript_.exchanges.data());
      is_done_[at] = true;
      for (const RecordedPacket& packet : next_answers(at)) from_board_.push_back(packet.octets);
    }
  }
  std::vector<RecordedPacket> next_answers(std::size_t at) const {
    std::vector<RecordedPacket> rest = transcript_.exchanges[at].answers;
    std::erase_if(rest, [](const RecordedPacket& packet) { return packet.octets[1] == 0x84; });
    return rest;
  }
  static bool is_same(const Bytes& recorded, const Bytes& written) {
    if (frame_opcode_of(recorded) == echo) return frame_opcode_of(written) == echo;
    // The recorded gateway had a single address.
    if (frame_opcode_of(recorded) == local_unicast_set)
      return written.size() >= 4 &&
             std::ranges::equal(ByteView(recorded).first(4), ByteView(written).first(4));
    return recorded == written;
  }
  static Bytes echoed(Bytes frame) {
    frame[1] = 0x82;
    return frame;
  }

  Transcript transcript_;
  MeshKeys keys_;
  std::vector<bool> is_done_;  ///< for each exchange
  std::optional<std::size_t> acted_at_;
  std::deque<Bytes> from_board_;
  bool has_failed_ = false;

 public:
  TimePoint now{};
  BleMesh mesh;
  NodeDatabase stored;
  std::vector<OrderAnswer> answers;
  std::vector<Bytes> written_after_end;
  std::uint64_t last_command = 0;
};

const std::vector<std::string> releases{"2.2.0", "3.1.0", "5.0.0"};

TEST(LifeReplay, WritesRecordedCommandsWithEachRelease) {
  for (const std::string& release : releases) {
    SCOPED_TRACE(release);
    LifeReplay replay(life("life", release), Settings{});
    replay.run();
    // 58 updates and the message "2" that the robot wanted acknowledged.
    std::uint16_t number = 2;
    std::size_t owed = 0;
    for (const Report& report : replay.all<Report>()) {
      owed += report.receipt.is_owed() ? 1 : 0;
      if (report.topic == "ntnu-slam/robot/ble-0100/adv") continue;
      EXPECT_EQ(report.topic, "ntnu-slam/robot/ble-0100/update");
      EXPECT_EQ(ByteReader(report.payload).read_u16_le(), ++number);
    }
    EXPECT_EQ(number, 0x3a);
    EXPECT_EQ(owed, 12u);
    const auto outcomes = replay.all<CommandOutcome>();
    ASSERT_EQ(outcomes.size(), 4u);
    for (const CommandOutcome& outcome : outcomes)
      EXPECT_EQ(outcome.result, CommandResult::delivered) << outcome.type;
    ASSERT_EQ(replay.answers.size(), 1u);
    EXPECT_EQ(replay.answers[0].error, "");
    EXPECT_TRUE(replay.stored.nodes.empty());
    ASSERT_EQ(replay.stored.removed.size(), 1u);
    EXPECT_EQ(replay.stored.removed[0].address, 0x0100);
    EXPECT_TRUE(replay.written_after_end.empty());
  }
}

TEST(LifeReplay, WritesRecordedCommandsWithStaticOobAndEachRelease) {
  for (const std::string& release : releases) {
    SCOPED_TRACE(release);
    Settings settings;
    settings.provisioning.static_oob = "6e6f726469635f6578616d706c655f31";
    const Transcript recorded = life("life_static_oob", release);
    LifeReplay replay(recorded, settings);
    replay.run();
    EXPECT_EQ(replay.all<Report>().size(), 3u);
    ASSERT_EQ(replay.stored.nodes.size(), 1u);
    EXPECT_EQ(replay.stored.nodes[0].state, NodeState::configured);
    EXPECT_EQ(to_hex(*replay.stored.nodes[0].device_key),
              to_hex(octets_of<16>(recorded, devkey_add, 6)));
    ASSERT_EQ(replay.written_after_end.size(), 1u) << "the STATUS for the last update";
    EXPECT_EQ(frame_opcode_of(replay.written_after_end[0]), packet_send);
  }
}

/// Runs a session through the recorded provisioning of one release. Each of its commands must be
/// one that the recorded host wrote and the board accepted.
class ProvisioningReplay {
 public:
  ProvisioningReplay(const std::string& name, const std::string& release,
                     std::optional<Key> static_oob)
      : transcript_(test::read_transcript("provisioning.txt", name, release)),
        session(device(static_oob), key_pair(), 0,
                {.version = release == "2.2.0" ? SerialVersion::sdk_2_2 : SerialVersion::sdk_3_1},
                actions_, now_) {}

  void run() {
    while (const auto command = session.command()) {
      const Exchange* exchange = find(*command);
      ASSERT_NE(exchange, nullptr) << to_hex(*command);
      for (const RecordedPacket& packet : exchange->answers) hear(packet);
      if (session.wants_addresses()) session.on_addresses(now_);
    }
  }
  /// Returns the device's key as hex; empty if the device has not joined.
  std::string device_key() {
    while (const auto action = actions_.pop()) {
      const auto* event = std::get_if<RadioEvent>(&*action);
      const auto* concern = event ? std::get_if<ProvisionerEvent>(event) : nullptr;
      const auto* joined = concern ? std::get_if<DeviceJoined>(concern) : nullptr;
      if (joined != nullptr) return to_hex(*joined->device_key);
    }
    return {};
  }

 private:
  static KeyPair key_pair() {
    std::array<std::uint8_t, 32> private_key{};
    std::iota(private_key.begin(), private_key.end(), std::uint8_t{1});
    return *key_pair_of(private_key);
  }
  static ProvisionDevice device(const std::optional<Key>& static_oob) {
    ProvisionDevice device;
    std::ranges::copy(std::string_view("slamrobot-000001"), device.uuid.begin());
    std::iota(device.net_key.begin(), device.net_key.end(), std::uint8_t{0x10});
    device.address = 0x0100;
    device.static_oob = static_oob;
    return device;
  }
  const Exchange* find(const Bytes& command) {
    for (; next_ < transcript_.exchanges.size(); ++next_) {
      const Exchange& exchange = transcript_.exchanges[next_];
      const bool is_taken = std::ranges::any_of(exchange.answers, [](const RecordedPacket& packet) {
        return packet.octets[1] == 0x84 && packet.octets[3] == 0;
      });
      if (exchange.command == command && is_taken) return &transcript_.exchanges[next_++];
    }
    return nullptr;
  }
  void hear(const RecordedPacket& packet) {
    const auto event = decode_event(ByteView(packet.octets).subspan(1));
    ASSERT_TRUE(event.has_value()) << packet.text();
    if (const auto* response = std::get_if<CommandResponse>(&*event))
      session.on_response(*response, false);
    if (const auto* provisioning = std::get_if<ProvisioningEvent>(&*event))
      session.on_event(*provisioning, now_);
  }

  Transcript transcript_;
  std::size_t next_ = 0;
  TimePoint now_{};
  ActionQueue<RadioAction> actions_;
  ProvisioningSession session;
};

Key oob_of(std::string_view text) {
  Key key{};
  std::ranges::copy(text, key.begin());
  return key;
}

TEST(ProvisioningReplay, WritesRecordedCommandsOfEachRelease) {
  for (const std::string& release : releases) {
    SCOPED_TRACE(release);
    ProvisioningReplay plain("provision", release, std::nullopt);
    plain.run();
    EXPECT_EQ(plain.device_key(), "4f9b791fe10a9fd654fa704b5923a890");
    ProvisioningReplay with_oob("provision_static_oob", release, oob_of("nordic_example_1"));
    with_oob.run();
    EXPECT_EQ(with_oob.device_key(), "3022bf889767b2e5638618eb0c6f8729");
  }
}

bool was_recorded(std::string_view command, std::string_view answer) {
  for (const Exchange& exchange :
       test::read_transcript("configuration.txt", "configuration", "3.1.0").exchanges)
    for (const RecordedPacket& packet : exchange.answers)
      if (carries(exchange.command, command) && packet.octets[1] == 0xd0 &&
          Bytes(packet.octets.begin() + 21, packet.octets.end()) == hex(answer))
        return true;
  return false;
}

TEST(LifeReplay, AnswersInPlaceOfOverwriteWereRecorded) {
  EXPECT_TRUE(was_recorded("80 2b 00 01 59 00 05 00", "80 2c 00 00 01 59 00 05 00")) << "none";
  EXPECT_TRUE(was_recorded("80 29 00 01 00 10", "80 2a 00 00 01 00 10 02 c0")) << "one";
  EXPECT_TRUE(was_recorded("80 1b 00 01 02 c0 59 00 05 00", "80 1f 00 00 01 02 c0 59 00 05 00"));
}

}  // namespace
}  // namespace slamgw::ble
