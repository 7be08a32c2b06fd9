// SPDX-License-Identifier: Apache-2.0
#include "daemon/observability/link_log.hpp"

#include <fmt/format.h>

namespace slamgw {

Notice LinkLog::on_up(const std::string& detail) {
  why_.clear();
  return {Severity::notice,
          fmt::format("broker {} connected ({})", uri_, detail),
          {},
          Occasion::broker_link};
}

std::optional<Notice> LinkLog::on_down(const std::string& why, TimePoint now) {
  const bool is_news = why != why_;
  if (is_news) {
    why_ = why;
    same_reason_ = LogThrottle(summary_interval);
  }
  const auto attempts = same_reason_.on_event(now);
  if (!attempts) return std::nullopt;
  const std::string again = is_news ? "" : fmt::format(" ({} attempts)", *attempts);
  return Notice{Severity::warning,
                fmt::format("cannot reach broker {}: {}; retrying{}", uri_, why, again),
                {},
                Occasion::broker_link};
}

Notice LinkLog::on_left(const std::string& why) const {
  return {
      Severity::info, fmt::format("leaving broker {}: {}", uri_, why), {}, Occasion::broker_link};
}

}  // namespace slamgw
