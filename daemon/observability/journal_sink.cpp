// SPDX-License-Identifier: Apache-2.0
#include "daemon/observability/journal_sink.hpp"

#include <errno.h>
#include <fmt/format.h>

#include "daemon/observability/journal_entry.hpp"

namespace slamgw {

/// While the journal is stuck, robot traffic may be lost; notices and warnings are kept.
void JournalSink::sink_it_(const spdlog::details::log_msg& message) {
  const std::string_view text(message.payload.data(), message.payload.size());
  static const LogFields none;
  socket_.send(journal_entry(program_invocation_short_name, context_.severity, text,
                             context_.fields ? *context_.fields : none),
               context_.severity >= Severity::notice);
}

void JournalSink::flush_() {
  if (!socket_.flush()) return;
  if (lost_ += socket_.take_lost(); lost_ == 0) return;
  const auto now = std::chrono::steady_clock::now();
  if (lost_reported_at_ && now - *lost_reported_at_ < lost_interval) return;
  const std::string text =
      fmt::format("{} log entries are lost: the journal did not take them", lost_);
  socket_.send(journal_entry(program_invocation_short_name, Severity::warning, text, {}), false);
  if (socket_.take_lost() > 0) return;  // still failing
  lost_ = 0;
  lost_reported_at_ = now;
}

}  // namespace slamgw
