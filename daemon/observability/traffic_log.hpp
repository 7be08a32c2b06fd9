// SPDX-License-Identifier: Apache-2.0
// Writes robot messages to the log: watches the traffic and writes what TrafficSampler picks, each
// line when its receipt has fired.
#pragma once

#include "daemon/core/traffic_event.hpp"
#include "daemon/observability/awaited_lines.hpp"
#include "daemon/observability/log.hpp"
#include "daemon/observability/traffic_sampler.hpp"

namespace slamgw {

class TrafficLog final : public TrafficObserver {
 public:
  explicit TrafficLog(TrafficLogMode mode) : sampler_(mode) {}

  void on_traffic(const TrafficEvent& event) override;
  void on_receipt(const Receipt& receipt, ReceiptOutcome outcome, TimePoint now) override;
  /// Writes lines that have waited for too long. Every few seconds.
  void write_overdue(TimePoint now);
  /// `log.traffic` was read again.
  void reconfigure(TrafficLogMode mode) { sampler_ = TrafficSampler(mode); }

 private:
  TrafficSampler sampler_;
  AwaitedLines awaited_;
};

}  // namespace slamgw
