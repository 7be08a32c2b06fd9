// SPDX-License-Identifier: Apache-2.0
// One run: a load, its path to the broker, and the arrivals at a subscriber there.
#pragma once

#include <sys/types.h>

#include <functional>
#include <string>

#include "tests/bench/arrivals.hpp"
#include "tests/bench/mqtt_socket.hpp"
#include "tests/bench/process_usage.hpp"
#include "tests/bench/sender.hpp"

namespace slamgw::bench {

enum class Pace : std::uint8_t {
  flat_out,    ///< QoS 1: the sender's window; QoS 0: a bounded number on the way to the subscriber
  fixed_rate,  ///< open loop: a message counts from when it was due, sent or not
  aligned,     ///< the same rate, but all clients send at the same instant, again and again
  at_once,     ///< one message of each client, back to back
};

struct Load {
  Pace pace = Pace::flat_out;
  std::size_t clients = 1;
  unsigned qos = 1;
  double per_second = 0;  ///< of all clients together; for fixed_rate and aligned
  std::chrono::milliseconds duration{4000};
};

struct RunResult {
  std::string name;
  std::string path;  ///< "gateway", "gateway mosquitto", or a floor: "raw", "paho", ...
  Load load;
  std::uint64_t sent = 0, received = 0, duplicates = 0, repeats = 0;
  double per_second = 0;  ///< arrivals, from the first submit to the last arrival
  Percentiles latency;
  double cpu_us = 0;            ///< of the process between, per message received
  double context_switches = 0;  ///< likewise
  std::uint64_t rss_kib = 0;    ///< of the process between, at the end
  std::uint64_t drops = 0;      ///< datagrams that the kernel dropped on their way to it
  double generator_cpu = 0;     ///< share of one core; near 1 the generator limits the result

  std::uint64_t lost() const { return sent - received; }
};

/// The subscriber, and the sender once it exists; both on one poller and one thread.
class Run {
 public:
  Run(std::string name, std::string path, Load load, const Address& broker);

  Poller& poller() { return poller_; }
  std::uint32_t number() const { return number_; }
  const Arrivals& arrivals() const { return arrivals_; }
  static constexpr std::uint64_t first_sender_token = 1;

  /// `process`: whose use is measured, or 0. `udp_port`: its, on this host, or 0.
  RunResult drive(Sender& sender, pid_t process, std::uint16_t udp_port = 0);
  /// Runs a floor that is a program and sends the same load by itself (floor.hpp).
  /// `has_properties`: by MQTT 5, with user properties as the gateway's.
  RunResult watch(const std::string& program, bool has_properties);
  /// Call it before or after drive(): takes arriving messages until `is_enough`, or for `limit`.
  bool listen(const std::function<bool(const Arrivals&)>& is_enough, std::chrono::seconds limit);

 private:
  void send_flat_out(Sender& sender);
  void send_at_rate(Sender& sender);
  void send_at_once(Sender& sender);
  void submit(Sender& sender, std::size_t client, Clock::time_point due);
  void turn(Sender* sender, Clock::time_point until);
  void drain(Sender* sender);
  void finish(Clock::time_point begin);

  std::uint32_t number_;
  Address broker_;
  Poller poller_;
  MqttSocket subscriber_;
  Arrivals arrivals_;
  RunResult result_;
  std::vector<std::uint32_t> sequences_;
  Clock::time_point next_tick_{};
};

}  // namespace slamgw::bench
