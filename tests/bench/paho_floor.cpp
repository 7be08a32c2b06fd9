// SPDX-License-Identifier: Apache-2.0
// The second floor: the same load by bare Paho C++ in its best pattern: one async_client, a window
// of 16, no persistence, callbacks that only count. With `properties` it speaks MQTT 5 and each
// message has three user properties as long as the gateway's. A program of its own so that its use
// can be told from the generator's. Run by slam-gateway-bench.
#include <sys/resource.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <semaphore>
#include <thread>

#include "mqtt/async_client.h"
#include "tests/bench/process_usage.hpp"
#include "tests/bench/raw_sender.hpp"

namespace {

using namespace slamgw::bench;

/// Paho 1.3 may lose the completion of a QoS 0 message: go on without.
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

double cpu_us() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  const auto us = [](const timeval& time) {
    return static_cast<double>(time.tv_sec) * 1e6 + static_cast<double>(time.tv_usec);
  };
  return us(usage.ru_utime) + us(usage.ru_stime);
}

struct Order {
  std::uint32_t run;
  std::size_t clients;
  int qos;
  double per_second;
  std::chrono::milliseconds duration;
  bool has_properties;
};

mqtt::properties user_properties() {
  mqtt::properties properties;
  for (const auto& [name, value] : {std::pair{"mesh", "thread"}, std::pair{"gateway", "bench"},
                                    std::pair{"received_at", "2026-01-01T00:00:00.000Z"}})
    properties.add({mqtt::property::USER_PROPERTY, name, value});
  return properties;
}

/// Returns how many it sent.
std::uint64_t send_all(mqtt::async_client& client, Window& window, const Order& order,
                       Clock::time_point begin) {
  // Paho copies what it publishes: one message is filled in again for each.
  const auto form = std::make_shared<mqtt::message>();
  form->set_qos(order.qos);
  if (order.has_properties) form->set_properties(user_properties());
  std::uint64_t sent = 0;
  for (auto due = begin; due < begin + order.duration; ++sent) {
    if (order.per_second > 0) std::this_thread::sleep_until(due);
    window.enter();
    Message message;
    message.due_ns = to_ns(order.per_second > 0 ? due : Clock::now());
    message.run = order.run;
    message.client = static_cast<std::uint32_t>(sent % order.clients);
    message.sequence = static_cast<std::uint32_t>(sent / order.clients);
    const Bytes payload = to_payload(message);
    form->set_topic(topic_of(message.client));
    form->set_payload(payload.data(), payload.size());
    client.publish(form, nullptr, window);
    due = order.per_second > 0
              ? begin + std::chrono::nanoseconds(
                            std::int64_t(static_cast<double>(sent + 1) * 1e9 / order.per_second))
              : Clock::now();
  }
  return sent;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 8) return 2;
  const Order order{static_cast<std::uint32_t>(std::atoi(argv[2])),
                    static_cast<std::size_t>(std::atoi(argv[3])),
                    std::atoi(argv[4]),
                    std::atof(argv[5]),
                    std::chrono::milliseconds(std::atoi(argv[6])),
                    argv[7] == std::string_view("properties")};
  Window window;
  const int version = order.has_properties ? MQTTVERSION_5 : MQTTVERSION_3_1_1;
  mqtt::async_client client(std::string("tcp://127.0.0.1:") + argv[1], "bench-paho",
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
  const double cpu_before = cpu_us();
  const ProcessUsage before = usage_of(getpid());
  const auto begin = Clock::now();
  const std::uint64_t sent = send_all(client, window, order, begin);
  for (std::size_t i = 0; i < broker_window; ++i) window.enter();
  const ProcessUsage after = usage_of(getpid());
  std::printf(
      "{\"sent\": %llu, \"begin_ns\": %lld, \"cpu_us\": %.0f, \"context_switches\": %llu, "
      "\"rss_kib\": %llu}\n",
      static_cast<unsigned long long>(sent), static_cast<long long>(to_ns(begin)),
      cpu_us() - cpu_before,
      static_cast<unsigned long long>(after.context_switches - before.context_switches),
      static_cast<unsigned long long>(after.rss_kib));
  client.disconnect()->wait();
  return 0;
}
