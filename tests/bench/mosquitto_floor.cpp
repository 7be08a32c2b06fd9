// SPDX-License-Identifier: Apache-2.0
// The third floor: the same load by bare libmosquitto, driven from one thread through its own
// socket, with a window of 16. A program of its own so that its use is measured apart from
// the generator's. Run by slam-gateway-bench.
#include <mosquitto.h>
#include <mqtt_protocol.h>
#include <poll.h>
#include <sys/prctl.h>

#include <stdexcept>

#include "tests/bench/floor.hpp"
#include "tests/bench/raw_sender.hpp"

namespace {

using namespace slamgw::bench;

constexpr int keep_alive_s = 60;

class Publisher {
 public:
  explicit Publisher(const Order& order) : order_(order) {
    mosquitto_lib_init();
    client_ = mosquitto_new("bench-libmosquitto", true, this);
    mosquitto_int_option(client_, MOSQ_OPT_PROTOCOL_VERSION,
                         order.has_properties ? MQTT_PROTOCOL_V5 : MQTT_PROTOCOL_V311);
    mosquitto_int_option(client_, MOSQ_OPT_TCP_NODELAY, 1);
    mosquitto_int_option(client_, MOSQ_OPT_SEND_MAXIMUM, 0);  // the window is here
    mosquitto_connect_callback_set(client_, [](mosquitto*, void* self, int) {
      static_cast<Publisher*>(self)->is_connected_ = true;
    });
    mosquitto_publish_callback_set(
        client_, [](mosquitto*, void* self, int) { --static_cast<Publisher*>(self)->unfinished_; });
    if (order.has_properties) {
      for (const auto& [name, value] : gateway_properties)
        mosquitto_property_add_string_pair(&properties_, MQTT_PROP_USER_PROPERTY, name, value);
    }
    check(mosquitto_connect(client_, "127.0.0.1", order.broker_port, keep_alive_s));
    while (!is_connected_) turn(Clock::now() + std::chrono::seconds(1));
  }
  ~Publisher() {
    mosquitto_disconnect(client_);
    mosquitto_destroy(client_);
    mosquitto_property_free_all(&properties_);
  }
  Publisher(const Publisher&) = delete;
  Publisher& operator=(const Publisher&) = delete;

  /// Returns how many messages it sent; all are acknowledged.
  std::uint64_t send_all(Clock::time_point begin) {
    std::uint64_t sent = 0;
    for (auto due = begin; due < begin + order_.duration; due = order_.due(begin, sent)) {
      if (order_.per_second > 0 && Clock::now() < due) {
        turn(due);
      } else if (unfinished_ >= broker_window) {
        turn(begin + order_.duration);
      } else {
        publish(order_.message(sent++, due));
      }
    }
    while (unfinished_ > 0) turn(Clock::now() + std::chrono::seconds(1));
    return sent;
  }

 private:
  static void check(int result) {
    if (result != MOSQ_ERR_SUCCESS) throw std::runtime_error(mosquitto_strerror(result));
  }

  void publish(const Message& message) {
    const Bytes payload = to_payload(message);
    ++unfinished_;
    check(mosquitto_publish_v5(client_, nullptr, topic_of(message.client).c_str(),
                               static_cast<int>(payload.size()), payload.data(), order_.qos, false,
                               properties_));
  }

  void turn(Clock::time_point until) {
    pollfd socket{mosquitto_socket(client_), POLLIN, 0};
    if (mosquitto_want_write(client_)) socket.events |= POLLOUT;
    const auto left =
        std::max(std::chrono::nanoseconds::zero(), std::chrono::nanoseconds(until - Clock::now()));
    const timespec timeout{left.count() / 1'000'000'000, left.count() % 1'000'000'000};
    ppoll(&socket, 1, &timeout, nullptr);
    if (socket.revents & POLLOUT) check(mosquitto_loop_write(client_, 1));
    if (socket.revents & ~POLLOUT) check(mosquitto_loop_read(client_, 1));
    mosquitto_loop_misc(client_);
  }

  const Order order_;
  mosquitto* client_ = nullptr;
  mosquitto_property* properties_ = nullptr;
  bool is_connected_ = false;
  std::size_t unfinished_ = 0;
};

}  // namespace

int main(int argc, char** argv) {
  if (argc != Order::argument_count) return 2;
  prctl(PR_SET_TIMERSLACK, 1UL);  // as the load generator
  Publisher publisher{Order(argv)};
  const FloorUsage usage;
  const auto begin = Clock::now();
  const std::uint64_t sent = publisher.send_all(begin);
  usage.print(sent, begin);
  return 0;
}
