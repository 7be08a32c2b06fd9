// SPDX-License-Identifier: Apache-2.0
#include "daemon/observability/link_log.hpp"

#include <fmt/format.h>

#include <utility>

namespace slamgw {

Notice LinkLog::on_up(const std::string& detail, const Now& now) {
  is_up_ = true;
  since_ = now.wall;
  why_.clear();
  return {Severity::notice,
          fmt::format("broker {} connected ({})", uri_, detail),
          {},
          Occasion::broker_link};
}

std::optional<Notice> LinkLog::on_down(const std::string& why, const Now& now) {
  const bool is_news = std::exchange(is_up_, false) || why != why_;
  if (is_news) {
    why_ = why;
    since_ = now.wall;
    same_reason_ = Burst(summary_interval);
  }
  const auto attempts = same_reason_.on_event(now.mono);
  if (!attempts) return std::nullopt;
  const std::string again = is_news ? "" : fmt::format(" ({} attempts)", *attempts);
  return Notice{Severity::warning,
                fmt::format("broker {} is not reached: {}; trying again{}", uri_, why, again),
                {},
                Occasion::broker_link};
}

}  // namespace slamgw
