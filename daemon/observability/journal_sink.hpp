// SPDX-License-Identifier: Apache-2.0
// spdlog sink that writes structured entries to the systemd journal. spdlog has no fields of its
// own: they come beside the message, through a context that log_event fills.
#pragma once

#include <spdlog/details/null_mutex.h>
#include <spdlog/sinks/base_sink.h>

#include <chrono>
#include <optional>
#include <string>

#include "daemon/observability/journal_socket.hpp"
#include "daemon/observability/log.hpp"

namespace slamgw {

/// What spdlog cannot carry about the message being written.
struct LogContext {
  Severity severity = Severity::info;
  const LogFields* fields = nullptr;
};

class JournalSink final : public spdlog::sinks::base_sink<spdlog::details::null_mutex> {
 public:
  /// `path`: the journal's socket.
  explicit JournalSink(const LogContext& context, std::string path = "/run/systemd/journal/socket")
      : context_(context), socket_(std::move(path)) {}

 private:
  static constexpr std::chrono::seconds lost_interval{1};

  void sink_it_(const spdlog::details::log_msg& message) override;
  /// Also called every few seconds: sends what was kept once the journal takes it.
  void flush_() override;

  const LogContext& context_;
  JournalSocket socket_;
  std::uint64_t lost_ = 0;  ///< and not reported yet
  std::optional<std::chrono::steady_clock::time_point> lost_reported_at_;
};

}  // namespace slamgw
