// SPDX-License-Identifier: Apache-2.0
// Lines of the log about the broker link: each change and each new reason at once, a repeated
// reason as a summary.
#pragma once

#include <optional>
#include <string>

#include "daemon/core/log_throttle.hpp"
#include "daemon/core/messages.hpp"

namespace slamgw {

class LinkLog {
 public:
  explicit LinkLog(std::string uri) : uri_(std::move(uri)) {}
  void rename(std::string uri) { uri_ = std::move(uri); }

  Notice on_up(const std::string& detail);
  /// Nothing when there is no news.
  std::optional<Notice> on_down(const std::string& why, TimePoint now);
  /// A good connection was ended for another one.
  Notice on_left(const std::string& why) const;

 private:
  static constexpr std::chrono::seconds summary_interval{60};

  std::string uri_;
  std::string why_;  ///< of the last line; empty while it is up
  LogThrottle same_reason_{summary_interval};
};

}  // namespace slamgw
