// SPDX-License-Identifier: Apache-2.0
// Writes robot messages to the log: watches the traffic and writes the lines that TrafficSampler
// picks. The line about a message whose acknowledgement is owed is written when the delay is known
// (LATENCY_US), or without the delay when the acknowledgement takes too long.
#pragma once

#include <functional>
#include <map>
#include <string>
#include <utility>

#include "daemon/core/traffic_event.hpp"
#include "daemon/observability/log.hpp"
#include "daemon/observability/traffic_sampler.hpp"

namespace slamgw {

class TrafficLog {
 public:
  /// Lines that may await their delay; further lines are written at once.
  static constexpr std::size_t max_awaiting = 1024;
  static constexpr std::chrono::seconds patience{5};

  using Write = std::function<void(const std::string& text, const LogFields& fields)>;

  /// `unproven` must outlive this object.
  TrafficLog(TrafficLogMode mode, UnprovenLines& unproven, Write write = write_info)
      : unproven_(unproven), sampler_(mode, unproven), write_(std::move(write)) {}

  void on_traffic(const TrafficEvent& event);
  /// The receipt of a message on its way up has fired.
  void on_receipt(const Receipt& receipt, ReceiptOutcome outcome, TimePoint now);
  /// Writes lines that have waited too long. Call every few seconds.
  void write_overdue(TimePoint now);
  /// Call when `log.traffic` was read again.
  void reconfigure(TrafficLogMode mode) { sampler_ = TrafficSampler(mode, unproven_); }

 private:
  using Key = std::pair<Mesh, std::uint64_t>;
  struct Line {
    TimePoint since{};
    std::string text;
    LogFields fields;
  };

  static Key key_of(const Receipt& receipt) { return {receipt.mesh, receipt.id}; }
  static void write_info(const std::string& text, const LogFields& fields);

  UnprovenLines& unproven_;
  TrafficSampler sampler_;
  Write write_;
  std::map<Key, Line> awaiting_;
};

}  // namespace slamgw
