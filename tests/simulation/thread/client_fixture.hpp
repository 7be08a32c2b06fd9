// SPDX-License-Identifier: Apache-2.0
// A Thread robot's client on a virtual clock, with the actions of a scripted gateway. Written from
// the specification's layouts; used by the tests of the client.
#pragma once

#include <gtest/gtest.h>

#include <optional>
#include <string_view>
#include <utility>
#include <vector>

#include "simulation/thread/client.hpp"
#include "tests/simulation/hex.hpp"

namespace slamgw::sim::sn {

/// `receive` and `pass` drive the client; `take` returns its messages since the last call.
class ClientTest : public ::testing::Test {
 protected:
  void begin(int qos = 1, std::optional<std::uint64_t> messages = 3) {
    settings_.client_id = "robot1";
    settings_.qos = qos;
    settings_.messages = messages;
    client_.emplace(settings_, RobotBody(1, 1));
    client_->on_start(now_);
    fire();
  }

  /// Advances the clock; collects the client's messages in `sent_`.
  void pass(Duration time) {
    const TimePoint end = now_ + time;
    while (client_->deadline() && *client_->deadline() <= end) {
      now_ = std::max(now_, *client_->deadline());
      fire();
    }
    now_ = end;
  }
  void fire() {
    client_->on_deadline(now_);
    collect();
  }
  void collect() {
    while (auto outgoing = client_->next_datagram()) sent_.push_back(outgoing->datagram);
  }
  void receive(const Bytes& datagram) {
    client_->on_datagram(datagram, now_);
    collect();
  }
  void receive(std::string_view text) { receive(hex(text)); }
  std::vector<Bytes> take() { return std::exchange(sent_, {}); }
  std::vector<Bytes> take(Type type) {
    std::vector<Bytes> out = take();
    std::erase_if(out, [&](const Bytes& d) { return d[1] != static_cast<std::uint8_t>(type); });
    return out;
  }

  void connect_client() {
    receive("03 02 01");
    receive("02 06");
    receive("02 08");
    take();
    receive("03 05 00");
  }
  /// Answers all registrations: topic ids in the order of REGISTER (adv 1, update 2, cmd 3, run 4).
  void register_topics() {
    std::uint16_t id = 0;
    std::vector<Bytes> published;
    for (std::vector<Bytes> batch = take(); !batch.empty(); batch = take()) {
      for (const Bytes& datagram : batch) {
        if (datagram[1] == 0x0c) published.push_back(datagram);
        answer_setup(datagram, id);
      }
    }
    sent_ = published;
  }
  void answer_setup(const Bytes& request, std::uint16_t& id) {
    if (request[1] == 0x0a) {
      receive(regack(++id, get_u16_be(request, 4), 0));
    } else if (request[1] == 0x12) {
      Bytes suback = hex("08 13 20 00 03 00 00 00");
      suback[5] = request[3];
      suback[6] = request[4];
      receive(suback);
    }
  }
  void acknowledge_all(const std::vector<Bytes>& publishes) {
    for (const Bytes& p : publishes) receive(puback(get_u16_be(p, 3), get_u16_be(p, 5), 0));
  }

  ClientSettings settings_;  // changed before begin()
  TimePoint now_{std::chrono::seconds{1000}};
  std::optional<Client> client_;
  std::vector<Bytes> sent_;
};

}  // namespace slamgw::sim::sn
