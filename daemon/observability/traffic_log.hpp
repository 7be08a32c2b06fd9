// SPDX-License-Identifier: Apache-2.0
// Robot messages as log lines: `thread NRF_5 update x=120 y=-33 obstacles=2`. Decides which of them
// are worth a line (`log.traffic`): a journal entry costs a Pi's card more than the message itself,
// and journald drops what comes too fast, whatever it is.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#include "daemon/core/burst.hpp"
#include "daemon/core/traffic_event.hpp"
#include "daemon/observability/log.hpp"
#include "daemon/observability/log_settings.hpp"

namespace slamgw {

/// How many messages a line stands for.
struct TrafficLine {
  std::uint64_t of_stream = 1;  ///< this robot's, in this direction, of this type
  std::uint64_t of_others = 0;  ///< any robot's that had a line of their own if there were fewer
};

/// Lines in a row, then so many a second: never more than 9 000 in 30 s, where journald takes 10
/// 000 of a service unless its unit says otherwise (RateLimitBurst= in journald.conf(5)). The rest
/// is left for what matters.
class LineBudget {
 public:
  static constexpr std::int64_t at_once = 3000;
  static constexpr std::int64_t per_second = 200;

  /// False when there are too many.
  bool take(TimePoint now);

 private:
  static constexpr Duration interval = Duration(std::chrono::seconds{1}) / per_second;
  std::optional<TimePoint> spent_until_;
};

/// `sampled`: the first of each robot, direction and type, then at most one a second, which says
/// how many it stands for.
class TrafficSampler {
 public:
  /// Streams followed one by one; what is beyond shares one budget.
  static constexpr std::size_t max_streams = 65536;

  explicit TrafficSampler(TrafficLog mode) : mode_(mode) {}

  /// What a line for this one stands for; nothing when there is to be none.
  std::optional<TrafficLine> on_traffic(const TrafficEvent& event, TimePoint now);

 private:
  std::optional<std::uint64_t> sample(const TrafficEvent& event, TimePoint now);

  TrafficLog mode_;
  LineBudget budget_;
  std::uint64_t without_line_ = 0;
  std::unordered_map<std::string, Burst> streams_;
};

std::string traffic_text(const TrafficEvent& event, const TrafficLine& line);
LogFields traffic_fields(const TrafficEvent& event);

/// One line of the log.
struct TrafficEntry {
  std::string text;
  LogFields fields;
};

/// Lines about messages whose acknowledgement is owed: they are written when it is known how long
/// that took (LATENCY_US), or without it when it takes too long.
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

}  // namespace slamgw
