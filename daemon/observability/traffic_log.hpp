// SPDX-License-Identifier: Apache-2.0
// Writes robot messages to the log: watches the traffic and writes what TrafficSampler picks, each
// line when its receipt has fired.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "daemon/core/traffic_event.hpp"
#include "daemon/observability/log.hpp"
#include "daemon/observability/traffic_sampler.hpp"

namespace slamgw {

// Lines of the log about messages whose acknowledgement is owed: they are written when it is known
// how long that took (LATENCY_US), or without it when it takes too long. Pure.

/// One line of the log.
struct TrafficEntry {
  std::string text;
  LogFields fields;
};

class AwaitedLines {
 public:
  /// Lines about more messages than that are written at once.
  static constexpr std::size_t max_lines = 1024;
  static constexpr std::chrono::seconds patience{5};

  /// Gives the line back when there is nothing to wait for.
  std::optional<TrafficEntry> add(const TrafficEvent& event, TrafficEntry entry);
  bool has(const Receipt& receipt) const { return lines_.contains(key_of(receipt)); }
  /// For a line that it has.
  TrafficEntry on_receipt(const Receipt& receipt, ReceiptOutcome outcome, TimePoint now);
  /// Those that have waited for too long, oldest first on each mesh. Every few seconds.
  std::vector<TrafficEntry> take_overdue(TimePoint now);

 private:
  using Key = std::pair<Mesh, std::uint64_t>;
  static Key key_of(const Receipt& receipt) { return {receipt.mesh, receipt.id}; }
  struct Line {
    TimePoint since{};
    TrafficEntry entry;
  };

  std::map<Key, Line> lines_;
};

class TrafficLog final : public TrafficObserver {
 public:
  /// `unproven` outlives it.
  TrafficLog(TrafficLogMode mode, UnprovenLines& unproven)
      : unproven_(unproven), sampler_(mode, unproven) {}

  void on_traffic(const TrafficEvent& event) override;
  void on_receipt(const Receipt& receipt, ReceiptOutcome outcome, TimePoint now) override;
  /// Writes lines that have waited for too long. Every few seconds.
  void write_overdue(TimePoint now);
  /// `log.traffic` was read again.
  void reconfigure(TrafficLogMode mode) { sampler_ = TrafficSampler(mode, unproven_); }

 private:
  UnprovenLines& unproven_;
  TrafficSampler sampler_;
  AwaitedLines awaited_;
};

}  // namespace slamgw
