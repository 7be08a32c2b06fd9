// SPDX-License-Identifier: Apache-2.0
// The daemon's log: spdlog with one sink, the journal (structured fields) under systemd, else
// stderr. The only global of the daemon. Used by shells on the loop's thread; pure code leaves
// Notices instead.
#pragma once

#include <boost/asio/io_context.hpp>
#include <chrono>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "daemon/core/messages.hpp"
#include "daemon/runtime/timer.hpp"

namespace slamgw {

/// A journal field: name upper case, as documented in the manual. Shown only by the journal sink.
struct LogField {
  std::string_view name;
  std::string value;
};
using LogFields = std::vector<LogField>;

/// Chooses the sink and sets the level below which nothing is written. May be called again
/// (reload).
void configure_log(Severity level);
bool stderr_is_journal();
bool is_logged(Severity severity);
/// One event, one line: control characters in `text` are escaped, whatever their source.
void log_event(Severity severity, std::string_view text, const LogFields& fields = {});
/// As log_event(), but writes notices about an operator's order at any level.
void log_notice(const Notice& notice);
/// Sends again the entries that a stuck journal did not take, and reports lost ones.
void flush_log();

/// Calls flush_log() every 200 ms while entries wait for the journal. At most one object at a time.
class LogRetry {
 public:
  explicit LogRetry(boost::asio::io_context& io);
  ~LogRetry();
  LogRetry(const LogRetry&) = delete;
  LogRetry& operator=(const LogRetry&) = delete;

 private:
  static constexpr std::chrono::milliseconds interval{200};
  Timer timer_;
};

std::string_view to_string(Severity severity);

}  // namespace slamgw
