// SPDX-License-Identifier: Apache-2.0
// BleMesh on a BoardRadio, wired to a FakeBoard on one virtual clock. The machine's octets reach
// the board at once, and the board's answers arrive `latency` later.
#pragma once

#include <algorithm>
#include <deque>
#include <functional>
#include <random>
#include <string>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/ble_mesh.hpp"
#include "adapters/ble_mesh_usb_cdc/nordic/board_radio.hpp"
#include "tests/ble_mesh_usb_cdc/event_log.hpp"
#include "tests/ble_mesh_usb_cdc/fake_board.hpp"
#include "tests/ble_mesh_usb_cdc/hex.hpp"

namespace slamgw::ble {

inline constexpr std::uint16_t first_robot = 0x0100;
/// An update that wants a STATUS: 10 and -20, two octets each.
inline constexpr std::string_view update_set = "c9 59 00 0a 00 ec ff";

inline MeshKeys test_keys() {
  MeshKeys keys;
  keys.net_key.fill(0x11);
  keys.app_key.fill(0x22);
  return keys;
}

/// The new keys of a key refresh.
inline MeshKeys new_keys() {
  MeshKeys keys;
  keys.net_key.fill(0x33);
  keys.app_key.fill(0x44);
  return keys;
}

inline NodeDatabase test_database() {
  NodeDatabase database;
  database.keys = test_keys();
  return database;
}

/// Returns different octets at each call, the same in each test.
inline RandomSource test_random() {
  return [random = std::mt19937_64(3)](std::span<std::uint8_t> octets) mutable {
    for (std::uint8_t& octet : octets) octet = static_cast<std::uint8_t>(random());
    return true;
  };
}

class MeshRig : public EventLog {
 public:
  explicit MeshRig(const Settings& settings = {},
                   const std::optional<NodeDatabase>& database = test_database(),
                   RobotNames names = RobotNames({{"nr1", 0x0100, {}}}))
      : mesh(settings, TopicScheme("ntnu-slam", "gw"), std::move(names), database,
             std::make_unique<BoardRadio>(settings, database, test_random(), 7),
             [this, first = database ? 3 : 1](std::span<std::uint8_t> octets) {
               if (!has_randomness) return false;
               std::ranges::fill(octets, static_cast<std::uint8_t>(0x11 * (first + keys_drawn++)));
               return true;
             }) {}

  /// Opens the port; the link comes up later.
  void open() {
    mesh.on_port_open(now);
    drain();
  }
  void start() {
    mesh.on_start();
    open();
    run_for(std::chrono::seconds{1});
  }

  void say(const Bytes& from_board) {
    mesh.on_bytes(from_board, now);
    drain();
  }
  /// Delivers a robot's access message.
  void hear(std::uint16_t source, std::string_view payload, std::uint16_t group = 0) {
    say(board.message(source, hex(payload), group));
  }
  void receipt(std::uint64_t id, ReceiptOutcome outcome = ReceiptOutcome::safe) {
    mesh.on_receipt(id, outcome, now);
    drain();
  }
  void command(const std::string& topic, Bytes payload, bool retain = false,
               std::chrono::milliseconds waited = {}) {
    RobotMessage what{
        .robot = topic.substr(0, topic.find('/')),
        .message = {"ntnu-slam/server/" + topic, std::move(payload), Qos::at_least_once, retain},
        .command = CommandId{++last_command}};
    what.message.waited = waited;
    mesh.on_broker_message(what, now);
    drain();
  }
  void hold_session(const std::string& robot) {
    mesh.on_session_held(robot, now);
    drain();
  }
  std::vector<WaitingMessage> give_up(const std::string& robot) {
    std::vector<WaitingMessage> waiting = mesh.give_up(robot, now);
    drain();
    return waiting;
  }
  /// Returns the requests that show a robot's presence at this gateway.
  std::vector<SubscribeRequest> asked() const {
    auto requests = all<SubscribeRequest>();
    std::erase_if(requests, [](const SubscribeRequest& each) { return each.is_standing; });
    return requests;
  }

  void stop() {
    mesh.on_stop(now);
    drain();
  }

  void run_for(Duration time) {
    const TimePoint end = now + time;
    drain();
    while (true) {
      auto next = earlier(mesh.deadline(), end);
      if (!in_flight_.empty()) next = earlier(next, in_flight_.front().due);
      now = std::max(now, *next);
      if (!in_flight_.empty() && in_flight_.front().due <= now) {
        const Bytes bytes = std::move(in_flight_.front().bytes);
        in_flight_.pop_front();
        mesh.on_bytes(bytes, now);
      } else if (mesh.deadline() && *mesh.deadline() <= now) {
        mesh.on_deadline(now);
      } else if (now >= end) {
        return;
      }
      drain();
    }
  }

  /// Returns the board's messages to `destination`, as hex.
  std::vector<std::string> sent_to(std::uint16_t destination) const {
    std::vector<std::string> found;
    for (const auto& packet : board.sent)
      if (packet.destination == destination) found.push_back(to_hex(packet.payload));
    return found;
  }
  /// Returns the address that the board last sent from; 0 when it did not send.
  std::uint16_t source() const { return board.sent.empty() ? 0 : board.sent.back().source; }
  /// Sends a robot's request, so that the board sends an answer.
  std::uint16_t source_of_an_answer() {
    board.sent.clear();
    hear(first_robot, "ca 59 00");
    run_for(std::chrono::milliseconds{200});
    return source();
  }
  void power_cycle_board() {
    say(board.restart());
    run_for(std::chrono::seconds{1});
  }
  std::uint64_t counter(std::string_view name) const {
    for (const Counter& counter : mesh.counters())
      if (counter.name == name) return counter.value;
    return ~std::uint64_t{0};
  }

  /// Delivers octets of the board after the latency; `say` delivers at once.
  void deliver_later(Bytes bytes) {
    if (spoil) spoil(bytes);
    if (!bytes.empty()) in_flight_.push_back({now + latency, std::move(bytes)});
  }

  TimePoint now{};
  Duration latency = std::chrono::milliseconds{3};
  FakeBoard board;
  std::function<void(Bytes&)> spoil;  ///< damages a transfer, either way
  BleMesh mesh;
  std::vector<TimePoint> event_times;    ///< time of each event
  std::vector<std::size_t> sent_before;  ///< packets sent before each event
  std::vector<Duration> reopens;
  /// The mesh's keys are test_keys() first, then new_keys().
  int keys_drawn = 0;
  bool has_randomness = true;
  bool reopens_port = true;
  std::vector<NodeDatabase> stored;
  bool answers_stores = true;
  std::uint64_t last_command = 0;  ///< the id of the last command
  std::string store_problem;
  std::vector<OrderAnswer> answers;
  std::vector<HeardRobot> heard;

 private:
  struct Delivery {
    TimePoint due{};
    Bytes bytes;
  };

  void drain() {
    while (auto action = mesh.next_action()) {
      std::visit(overloaded{
                     [&](WriteSerial& write) {
                       if (spoil) spoil(write.bytes);
                       deliver_later(board.on_bytes(write.bytes));
                     },
                     [&](ReopenPort& reopen) {
                       reopens.push_back(reopen.after);
                       in_flight_.clear();
                       now += reopen.after;
                       if (reopens_port) mesh.on_port_open(now);
                     },
                     [&](StoreMesh& store) {
                       stored.push_back(std::move(store.database));
                       if (answers_stores) mesh.on_stored(store_problem, now);
                     },
                     [&](HeardRobot& robot) { heard.push_back(std::move(robot)); },
                     [&](OrderEnded& ended) { answers.push_back(std::move(ended.answer)); },
                     [&](MeshEvent& event) {
                       events.push_back(std::move(event));
                       event_times.push_back(now);
                       sent_before.push_back(board.sent.size());
                     },
                 },
                 *action);
    }
  }

  std::deque<Delivery> in_flight_;
};

}  // namespace slamgw::ble
