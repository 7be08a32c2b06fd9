// SPDX-License-Identifier: Apache-2.0
// The first floor: all clients' messages on one plain MQTT connection, straight to the broker.
#pragma once

#include <deque>

#include "tests/bench/mqtt_socket.hpp"
#include "tests/bench/sender.hpp"

namespace slamgw::bench {

/// Unacknowledged at once: what slam-gatewayd and the Paho floor use too.
constexpr std::size_t broker_window = 16;

class RawSender final : public Sender {
 public:
  RawSender(const Address& broker, std::size_t clients, Poller& poller, std::uint64_t token,
            std::string_view client_id = "bench-raw")
      : clients_(clients), socket_(broker, client_id) {
    poller.add(socket_.descriptor(), token);
    socket_.on_puback = [this](std::uint16_t) {
      --unacknowledged_;
      pump();
    };
  }

  std::optional<std::size_t> free_client() override {
    if (unfinished() >= broker_window) return std::nullopt;
    return next_++ % clients_;
  }

  void submit(const Message& message, unsigned qos) override {
    if (qos == 0) return socket_.publish(topic_of(message.client), to_payload(message), 0, 0);
    waiting_.push_back(message);
    pump();
  }

  std::size_t unfinished() const override { return unacknowledged_ + waiting_.size(); }
  void on_readable(std::uint64_t) override { socket_.on_readable(); }
  void on_tick(Clock::time_point) override {}
  void flush() override { socket_.flush(); }
  std::uint64_t repeats() const override { return 0; }

 private:
  void pump() {
    while (unacknowledged_ < broker_window && !waiting_.empty()) {
      const Message& message = waiting_.front();
      if (++id_ == 0) ++id_;
      socket_.publish(topic_of(message.client), to_payload(message), 1, id_);
      waiting_.pop_front();
      ++unacknowledged_;
    }
  }

  std::size_t clients_;
  MqttSocket socket_;
  std::deque<Message> waiting_;
  std::size_t unacknowledged_ = 0;
  std::size_t next_ = 0;
  std::uint16_t id_ = 0;
};

}  // namespace slamgw::bench
