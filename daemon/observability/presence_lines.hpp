// SPDX-License-Identifier: Apache-2.0
// Lines of the log about robots that come and go, and about commands: as many as a fleet needs, and
// no flood from a crowd of strangers or a server gone wild. Pure.
#pragma once

#include <fmt/format.h>
#include <cstdint>
#include <optional>
#include <utility>

#include "daemon/core/messages.hpp"
#include "daemon/observability/traffic_sampler.hpp"

namespace slamgw {

/// A burst of lines, then so many a second; counts the rest.
class BoundedLines {
 public:
  BoundedLines(unsigned at_once, unsigned per_second)
      : at_once_(at_once), per_second_(per_second) {}
  bool may_write(TimePoint now) {
    if (budget_.take(at_once_, per_second_, now)) return true;
    ++left_out_;
    return false;
  }
  /// Of lines left out since the last call, with their number before `words`; nothing without any.
  std::optional<Notice> summary(std::string_view words, Occasion occasion) {
    const std::uint64_t count = std::exchange(left_out_, 0);
    if (count == 0) return std::nullopt;
    return Notice{Severity::warning,
                  fmt::format("{} {} without a line of their own: too many at once", count, words),
                  {},
                  occasion};
  }

 private:
  unsigned at_once_;
  unsigned per_second_;
  TokenBucket budget_;
  std::uint64_t left_out_ = 0;
};

class PresenceLines {
 public:
  /// Enough for a thousand robots that come at once and 500 that go.
  static constexpr unsigned lines_at_once = 1500;
  static constexpr unsigned lines_per_second = 20;

  /// `unproven` outlives it.
  explicit PresenceLines(UnprovenLines& unproven) : unproven_(unproven) {}

  /// False when there were too many such lines; other notices about proven clients always pass.
  bool may_write(const Notice& notice, TimePoint now) {
    if (!notice.is_proven) return unproven_.may_write(notice.robot, now);
    return notice.occasion != Occasion::robot_presence || lines_.may_write(now);
  }
  /// Says how many were left out since the last call; to be called every few seconds.
  std::optional<Notice> summary() {
    return lines_.summary("robots came or went", Occasion::robot_presence);
  }

 private:
  UnprovenLines& unproven_;
  BoundedLines lines_{lines_at_once, lines_per_second};
};

/// Lines about how commands ended. Those about an operator's always pass.
class CommandLines {
 public:
  static constexpr unsigned lines_at_once = 1000;
  static constexpr unsigned lines_per_second = 50;

  /// False when there were too many such lines.
  bool may_write(const Notice& notice, TimePoint now) {
    const bool is_bounded = notice.occasion == Occasion::command_outcome && notice.audit &&
                            !is_operator(notice.audit->who);
    return !is_bounded || lines_.may_write(now);
  }
  /// As that of PresenceLines.
  std::optional<Notice> summary() {
    auto notice = lines_.summary("commands ended", Occasion::command_outcome);
    if (notice) notice->audit = AuditFacts{std::string(broker_sender), "commands", "not listed"};
    return notice;
  }

 private:
  BoundedLines lines_{lines_at_once, lines_per_second};
};

}  // namespace slamgw
