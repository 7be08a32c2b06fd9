// SPDX-License-Identifier: Apache-2.0
#include "tests/mqttsn_udp/fuzz_life.hpp"

#include <algorithm>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {
namespace {

constexpr std::ptrdiff_t max_clients = 3;
constexpr std::size_t max_sleeping = 4;

Settings small_settings() {
  Settings settings;
  settings.max_clients = max_clients;
  settings.max_sleeping_messages = max_sleeping;
  settings.allow_unconnected_publish = true;
  settings.when_full = WhenFull::reject;
  settings.predefined_topics = {{1, "a/p", {}}, {2, "b", "c"}};
  return settings;
}

}  // namespace

FuzzLife::FuzzLife()
    : gateway_(small_settings(), TopicPolicy(TopicScheme("p", "gw"), {"a", "a/#", "b"}, {"#"}),
               RobotNames()) {
  gateway_.on_broker_link(true, now_);
  gateway_.ask_where_served([this](const std::string& robot) { return notes_.contains(robot); });
}

bool FuzzLife::run(ByteView script) {
  ByteReader in(script);
  while (in.remaining() > 0) {
    one_input(in);
    if (!drain() || !holds()) return false;
  }
  return true;
}

void FuzzLife::one_input(ByteReader& in) {
  const std::uint8_t kind = in.read_u8() % 8;
  const std::uint8_t argument = in.read_u8();
  switch (kind) {
    case 0: now_ += std::chrono::seconds(argument); break;
    case 1:
      if (gateway_.deadline()) now_ = std::max(now_, *gateway_.deadline());
      gateway_.on_deadline(now_);
      break;
    case 2:
      gateway_.on_receipt(owed_.empty() ? argument : owed_[argument % owed_.size()],
                          argument % 4 == 0 ? ReceiptOutcome::refused : ReceiptOutcome::safe, now_);
      break;
    case 3:
      if (asked_.empty()) break;
      gateway_.on_subscribe_result(asked_[argument % asked_.size()].robot,
                                   asked_[argument % asked_.size()].filter, argument % 8 != 0,
                                   now_);
      break;
    case 4: link_or_roam(argument); break;
    case 5: broker_message(argument, in.read(in.read_u8())); break;
    default: datagram(argument, in.read(in.read_u8()));
  }
}

/// Sends one message with a fitting Length, so that more than the decoder is reached.
void FuzzLife::datagram(std::uint8_t from, ByteView octets) {
  Endpoint endpoint;
  endpoint.port = from % 6;
  ByteWriter message;
  message.write_u8(static_cast<std::uint8_t>(std::min<std::size_t>(octets.size() + 1, 255)));
  message.write(octets);
  gateway_.on_datagram(endpoint, LocalAddress{}, from >= 128 ? octets : message.bytes(), now_);
}

void FuzzLife::broker_message(std::uint8_t argument, ByteView payload) {
  static const char* const topics[] = {"a", "a/b", "b", "p/server/c/cmd", "p/robot/c/adv"};
  gateway_.on_broker_message({argument % 3 == 0 ? "d" : "c",
                              {topics[argument % 5], Bytes(payload.begin(), payload.end()),
                               static_cast<Qos>(argument / 5 % 3), argument % 2 == 0},
                              CommandId{argument},
                              argument % 7 == 0},
                             now_);
}

/// Changes the broker link or roams. Notes are the gateway's own, so that they are readable.
void FuzzLife::link_or_roam(std::uint8_t argument) {
  const std::string robot = argument % 8 < 4 ? "c" : "d";
  switch (argument % 4) {
    case 0: return gateway_.on_broker_link(argument % 8 == 0, now_);
    case 1: (void)gateway_.give_up(robot, now_); return;
    case 2: return gateway_.on_session_held(robot);
    default:
      return gateway_.on_note(
          robot, argument % 8 == 3 ? std::nullopt : std::optional<ByteView>(notes_[robot]), now_);
  }
}

bool FuzzLife::drain() {
  while (auto action = gateway_.next_action()) {
    if (const auto* sent = std::get_if<SendDatagram>(&*action)) {
      if (!is_sound(*sent)) return false;
    } else if (const auto* event = std::get_if<MeshEvent>(&*action)) {
      if (const auto* report = std::get_if<Report>(event)) {
        if (!is_valid_topic_name(report->topic)) return false;
        if (report->receipt.is_owed() && owed_.size() < 256) owed_.push_back(report->receipt.id);
      }
      const auto* asked = std::get_if<SubscribeRequest>(event);
      if (asked && asked_.size() < 256) asked_.push_back(*asked);
      if (const auto* changed = std::get_if<NoteChanged>(event); changed && !changed->note.empty())
        notes_[changed->robot] = changed->note;
      if (const auto* change = std::get_if<PresenceChange>(event)) robots_.insert(change->robot);
    }
  }
  return true;
}

/// Returns true for a valid MQTT-SN 1.2 message that the network can carry.
bool FuzzLife::is_sound(const SendDatagram& sent) const {
  if (sent.bytes.size() > limits::max_datagram_octets) return false;
  if (!is_encapsulated(sent.bytes)) return decode(sent.bytes).has_value();
  const auto outer = decode_encapsulation(sent.bytes);
  return outer && decode(outer->inner).has_value();
}

/// Returns true if the gateway's invariants hold. A robot whose CONNECT waits for its note is
/// present without a session.
bool FuzzLife::holds() const {
  const auto is_here = [this](const std::string& robot) {
    return gateway_.presence_of(robot).has_value();
  };
  const auto may_wait = static_cast<std::ptrdiff_t>(notes_.size());
  return std::ranges::count_if(robots_, is_here) <= max_clients + may_wait &&
         gateway_.queued_for("c") <= limits::max_queued_messages + 1;
}

}  // namespace slamgw::mqttsn
