// SPDX-License-Identifier: Apache-2.0
// Writes robot messages to the log: watches the traffic and writes the lines that TrafficSampler
// picks, each when its receipt has fired.
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

// Lines about messages whose acknowledgement is owed. A line is written when the delay is known
// (LATENCY_US), or without the delay when the acknowledgement takes too long. Pure.

/// One line of the log.
struct TrafficEntry {
  std::string text;
  LogFields fields;
};

class AwaitedLines {
 public:
  /// Lines beyond this number are written at once.
  static constexpr std::size_t max_lines = 1024;
  static constexpr std::chrono::seconds patience{5};

  /// Returns the entry when it does not have to wait.
  std::optional<TrafficEntry> add(const TrafficEvent& event, TrafficEntry entry);
  bool has(const Receipt& receipt) const { return lines_.contains(key_of(receipt)); }
  /// Removes and returns the line. Call only if has(receipt).
  TrafficEntry on_receipt(const Receipt& receipt, ReceiptOutcome outcome, TimePoint now);
  /// Removes and returns the lines that have waited too long, oldest first on each mesh. Call every
  /// few seconds.
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
  /// `unproven` must outlive this object.
  TrafficLog(TrafficLogMode mode, UnprovenLines& unproven)
      : unproven_(unproven), sampler_(mode, unproven) {}

  void on_traffic(const TrafficEvent& event) override;
  void on_receipt(const Receipt& receipt, ReceiptOutcome outcome, TimePoint now) override;
  /// Writes lines that have waited too long. Call every few seconds.
  void write_overdue(TimePoint now);
  /// Call when `log.traffic` was read again.
  void reconfigure(TrafficLogMode mode) { sampler_ = TrafficSampler(mode, unproven_); }

 private:
  UnprovenLines& unproven_;
  TrafficSampler sampler_;
  AwaitedLines awaited_;
};

}  // namespace slamgw
