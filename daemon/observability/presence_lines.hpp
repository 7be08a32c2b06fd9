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

class PresenceLines {
 public:
  /// Enough for a thousand robots that come at once and 500 that go.
  static constexpr std::int64_t lines_at_once = 1500;
  static constexpr std::int64_t lines_per_second = 20;

  /// `unproven` outlives it.
  explicit PresenceLines(UnprovenLines& unproven) : unproven_(unproven) {}

  /// False when there were too many such lines; other notices about proven clients always pass.
  bool may_write(const Notice& notice, TimePoint now) {
    if (!notice.is_proven) return unproven_.may_write(notice.robot, now);
    if (notice.occasion != Occasion::robot_presence || budget_.take(now)) return true;
    ++left_out_;
    return false;
  }
  /// Says how many were left out since the last call; to be called every few seconds.
  std::optional<Notice> summary() {
    const std::uint64_t count = std::exchange(left_out_, 0);
    if (count == 0) return std::nullopt;
    return Notice{
        Severity::warning,
        fmt::format("{} robots came or went without a line of their own: too many at once", count),
        {},
        Occasion::robot_presence};
  }

 private:
  UnprovenLines& unproven_;
  LineBudget budget_{lines_at_once, lines_per_second};
  std::uint64_t left_out_ = 0;
};

/// Lines about how commands ended. Those about an operator's always pass.
class CommandLines {
 public:
  static constexpr std::int64_t lines_at_once = 1000;
  static constexpr std::int64_t lines_per_second = 50;

  /// False when there were too many such lines.
  bool may_write(const Notice& notice, TimePoint now) {
    const bool is_bounded = notice.occasion == Occasion::command_outcome && notice.audit &&
                            !is_operator(notice.audit->who);
    if (!is_bounded || budget_.take(now)) return true;
    ++left_out_;
    return false;
  }
  /// As that of PresenceLines.
  std::optional<Notice> summary() {
    const std::uint64_t count = std::exchange(left_out_, 0);
    if (count == 0) return std::nullopt;
    Notice notice{
        Severity::warning,
        fmt::format("{} commands ended without a line of their own: too many at once", count),
        {},
        Occasion::command_outcome};
    notice.audit = AuditFacts{std::string(broker_sender), "commands", "not listed"};
    return notice;
  }

 private:
  LineBudget budget_{lines_at_once, lines_per_second};
  std::uint64_t left_out_ = 0;
};

}  // namespace slamgw
