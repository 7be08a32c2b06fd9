// SPDX-License-Identifier: Apache-2.0
// The common part of the floors that are programs of their own. It has their command line from
// slam-gateway-bench, and the line of JSON that they print.
#pragma once

#include <sys/resource.h>
#include <unistd.h>

#include <array>
#include <cstdio>
#include <cstdlib>
#include <string_view>
#include <utility>

#include "tests/bench/message.hpp"
#include "tests/bench/process_usage.hpp"

namespace slamgw::bench {

/// MQTT 5 user properties as long as those that the gateway adds to each message.
inline constexpr std::array<std::pair<const char*, const char*>, 3> gateway_properties{
    {{"mesh", "thread"}, {"gateway", "bench"}, {"received_at", "2026-01-01T00:00:00.000Z"}}};

/// BROKER_PORT RUN CLIENTS QOS PER_SECOND MILLISECONDS plain|properties
struct Order {
  int broker_port;
  std::uint32_t run;
  std::size_t clients;
  int qos;
  double per_second;  ///< 0: flat out
  std::chrono::milliseconds duration;
  bool has_properties;  ///< by MQTT 5, with `gateway_properties`

  static constexpr int argument_count = 8;
  explicit Order(char** arguments)
      : broker_port(std::atoi(arguments[1])),
        run(static_cast<std::uint32_t>(std::atoi(arguments[2]))),
        clients(static_cast<std::size_t>(std::atoi(arguments[3]))),
        qos(std::atoi(arguments[4])),
        per_second(std::atof(arguments[5])),
        duration(std::atoi(arguments[6])),
        has_properties(arguments[7] == std::string_view("properties")) {}

  /// Returns when the message with this number, from 0, is due; flat out: now.
  Clock::time_point due(Clock::time_point begin, std::uint64_t number) const {
    if (per_second <= 0) return Clock::now();
    const double ns = static_cast<double>(number) * 1e9 / per_second;
    return begin + std::chrono::nanoseconds(static_cast<std::int64_t>(ns));
  }

  Message message(std::uint64_t number, Clock::time_point due_at) const {
    Message out;
    out.due_ns = to_ns(due_at);
    out.run = run;
    out.client = static_cast<std::uint32_t>(number % clients);
    out.sequence = static_cast<std::uint32_t>(number / clients);
    return out;
  }
};

/// The use of this process between construction and print().
class FloorUsage {
 public:
  void print(std::uint64_t sent, Clock::time_point begin) const {
    const ProcessUsage after = usage_of(getpid());
    std::printf(
        "{\"sent\": %llu, \"begin_ns\": %lld, \"cpu_us\": %.0f, \"context_switches\": %llu, "
        "\"rss_kib\": %llu}\n",
        static_cast<unsigned long long>(sent), static_cast<long long>(to_ns(begin)),
        cpu_us() - cpu_before_us_,
        static_cast<unsigned long long>(after.context_switches - before_.context_switches),
        static_cast<unsigned long long>(after.rss_kib));
    std::fflush(stdout);
  }

 private:
  static double cpu_us() {
    rusage usage{};
    getrusage(RUSAGE_SELF, &usage);
    const auto us = [](const timeval& time) {
      return static_cast<double>(time.tv_sec) * 1e6 + static_cast<double>(time.tv_usec);
    };
    return us(usage.ru_utime) + us(usage.ru_stime);
  }

  const double cpu_before_us_ = cpu_us();
  const ProcessUsage before_ = usage_of(getpid());
};

}  // namespace slamgw::bench
