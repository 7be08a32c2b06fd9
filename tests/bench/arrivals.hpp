// SPDX-License-Identifier: Apache-2.0
// The messages of one run that a subscriber at the broker received: number, latency, duplicates.
#pragma once

#include <vector>

#include "tests/bench/message.hpp"

namespace slamgw::bench {

struct Percentiles {
  double p50_ms = 0, p99_ms = 0, p999_ms = 0, max_ms = 0;
};
/// Sorts `latencies`. Zeros when there are none.
Percentiles percentiles_of(std::vector<std::int64_t>& latencies_ns);

/// The run number of messages of no run: see Arrivals::others().
constexpr std::uint32_t no_run = 0;

class Arrivals {
 public:
  Arrivals(std::uint32_t run, std::size_t clients) : run_(run), seen_(clients) {}

  void on_payload(ByteView payload, Clock::time_point now);

  std::uint64_t unique() const { return latencies_ns_.size(); }
  std::uint64_t duplicates() const { return duplicates_; }
  Clock::time_point last() const { return last_; }
  /// Arrivals of messages of other runs, such as a backlog.
  struct Others {
    std::uint64_t count = 0;
    Clock::time_point first{}, last{};
  };
  const Others& others() const { return others_; }
  Percentiles latencies() { return percentiles_of(latencies_ns_); }

 private:
  std::uint32_t run_;
  std::vector<std::vector<bool>> seen_;  // by client, by sequence
  std::vector<std::int64_t> latencies_ns_;
  std::uint64_t duplicates_ = 0;
  Clock::time_point last_{};
  Others others_;
};

}  // namespace slamgw::bench
