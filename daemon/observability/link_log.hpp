// SPDX-License-Identifier: Apache-2.0
// The log's lines about the broker link: each change and each new reason at once, a repeated reason
// as a summary.
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
  /// Returns nothing for a repeated reason, except for a summary once a minute.
  std::optional<Notice> on_down(const std::string& why, TimePoint now);
  /// Returns the line about a good connection that was ended for another broker.
  Notice on_left(const std::string& why) const;

 private:
  static constexpr std::chrono::seconds summary_interval{60};

  std::string uri_;
  std::string why_;  ///< the last line's reason; empty while the link is up
  LogThrottle same_reason_{summary_interval};
};

}  // namespace slamgw
