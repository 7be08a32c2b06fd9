// SPDX-License-Identifier: Apache-2.0
// The second floor: the same load by bare Paho C++ in its best pattern: one async_client, a window
// of 16, no persistence, callbacks that only count. A program of its own so that its use is
// measured apart from the generator's. Run by slam-gateway-bench.
#include <semaphore>
#include <thread>

#include "mqtt/async_client.h"
#include "tests/bench/floor.hpp"
#include "tests/bench/raw_sender.hpp"

namespace {

using namespace slamgw::bench;

/// Paho 1.3 may lose the completion of a QoS 0 message: continues without it.
constexpr std::chrono::seconds completion_limit{2};
/// MQTTAsync's own buffer, never approached.
constexpr int max_buffered = 256;

class Window final : public mqtt::iaction_listener {
 public:
  void enter() { (void)free_.try_acquire_for(completion_limit); }
  void on_success(const mqtt::token&) override { free_.release(); }
  void on_failure(const mqtt::token&) override { free_.release(); }

 private:
  std::counting_semaphore<> free_{broker_window};
};

mqtt::properties user_properties() {
  mqtt::properties properties;
  for (const auto& [name, value] : gateway_properties)
    properties.add({mqtt::property::USER_PROPERTY, name, value});
  return properties;
}

/// Returns how many it sent.
std::uint64_t send_all(mqtt::async_client& client, Window& window, const Order& order,
                       Clock::time_point begin) {
  // Paho copies the messages, so one object is filled in again for each.
  const auto form = std::make_shared<mqtt::message>();
  form->set_qos(order.qos);
  if (order.has_properties) form->set_properties(user_properties());
  for (std::uint64_t sent = 0;; ++sent) {
    const auto due = order.due(begin, sent);
    if (due >= begin + order.duration) return sent;
    if (order.per_second > 0) std::this_thread::sleep_until(due);
    window.enter();
    const Message message = order.message(sent, order.per_second > 0 ? due : Clock::now());
    const Bytes payload = to_payload(message);
    form->set_topic(topic_of(message.client));
    form->set_payload(payload.data(), payload.size());
    client.publish(form, nullptr, window);
  }
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != Order::argument_count) return 2;
  const Order order(argv);
  Window window;
  const int version = order.has_properties ? MQTTVERSION_5 : MQTTVERSION_3_1_1;
  mqtt::async_client client("tcp://127.0.0.1:" + std::to_string(order.broker_port), "bench-paho",
                            mqtt::create_options(version, max_buffered), nullptr);
  mqtt::connect_options options;
  options.set_mqtt_version(version);
  if (order.has_properties) {
    options.set_clean_start(true);
  } else {
    options.set_clean_session(true);
  }
  options.set_max_inflight(max_buffered);
  client.connect(options)->wait();
  const FloorUsage usage;
  const auto begin = Clock::now();
  const std::uint64_t sent = send_all(client, window, order, begin);
  for (std::size_t i = 0; i < broker_window; ++i) window.enter();
  usage.print(sent, begin);
  client.disconnect()->wait();
  return 0;
}
