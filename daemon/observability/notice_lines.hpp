// SPDX-License-Identifier: Apache-2.0
// Bounds the log's lines about robots that come and go, about commands, and about messages that the
// broker refuses. A whole fleet passes; a flood from many unknown clients or from a faulty server
// does not. Pure.
#pragma once

#include <fmt/format.h>
#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

#include "daemon/core/messages.hpp"
#include "daemon/observability/traffic_sampler.hpp"

namespace slamgw {

/// Lets `at_once` lines pass, then `per_second`; counts the rest.
class BoundedLines {
 public:
  BoundedLines(unsigned at_once, unsigned per_second)
      : at_once_(at_once), per_second_(per_second) {}
  bool may_write(TimePoint now) {
    if (budget_.take(at_once_, per_second_, now)) return true;
    ++left_out_;
    return false;
  }
  /// Returns a notice that puts the number of lines left out since the last call before `words`;
  /// nothing when none was left out.
  std::optional<Notice> summary(std::string_view words, Occasion occasion) {
    const std::uint64_t count = std::exchange(left_out_, 0);
    if (count == 0) return std::nullopt;
    return Notice{Severity::warning,
                  fmt::format("{} more {}: too many to log one by one", count, words),
                  {},
                  occasion};
  }

 private:
  unsigned at_once_;
  unsigned per_second_;
  TokenBucket budget_;
  std::uint64_t left_out_ = 0;
};

class NoticeLines {
 public:
  /// Enough for a thousand robots that come at once and 500 that go.
  static constexpr unsigned presence_at_once = 1500;
  static constexpr unsigned presence_per_second = 20;
  static constexpr unsigned commands_at_once = 1000;
  static constexpr unsigned commands_per_second = 50;
  static constexpr unsigned refusals_at_once = 20;
  static constexpr unsigned refusals_per_second = 2;

  /// `unproven` must outlive this object.
  explicit NoticeLines(UnprovenLines& unproven) : unproven_(unproven) {}

  /// Returns false when there were too many such lines. Lines about an operator's commands, and
  /// notices of other occasions, always pass if their client is proven.
  bool may_write(const Notice& notice, TimePoint now) {
    if (!notice.is_proven) return unproven_.may_write(notice.robot, now);
    if (notice.occasion == Occasion::robot_presence) return presence_.may_write(now);
    if (notice.occasion == Occasion::broker_refusal) return refusals_.may_write(now);
    const bool is_brokers_command = notice.occasion == Occasion::command_outcome && notice.audit &&
                                    !is_operator(notice.audit->who);
    return !is_brokers_command || commands_.may_write(now);
  }
  /// Returns notices about the lines left out since the last call. Call every few seconds.
  std::vector<Notice> summaries() {
    std::vector<Notice> all;
    if (auto notice = presence_.summary("robots came or went", Occasion::robot_presence))
      all.push_back(std::move(*notice));
    if (auto notice = refusals_.summary("lines about messages that the broker refuses",
                                        Occasion::broker_refusal))
      all.push_back(std::move(*notice));
    if (auto notice = unproven_.summary()) all.push_back(std::move(*notice));
    if (auto notice = commands_.summary("commands ended", Occasion::command_outcome)) {
      notice->audit = AuditFacts{std::string(broker_sender), "commands", "not listed"};
      all.push_back(std::move(*notice));
    }
    return all;
  }

 private:
  UnprovenLines& unproven_;
  BoundedLines presence_{presence_at_once, presence_per_second};
  BoundedLines commands_{commands_at_once, commands_per_second};
  BoundedLines refusals_{refusals_at_once, refusals_per_second};
};

}  // namespace slamgw
