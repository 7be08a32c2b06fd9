// SPDX-License-Identifier: Apache-2.0
// spdlog sink that writes structured entries to the systemd journal. spdlog has no fields;
// log_event passes them beside the message, through a LogContext.
#pragma once

#include <spdlog/details/null_mutex.h>
#include <spdlog/sinks/base_sink.h>

#include <chrono>
#include <cstdint>
#include <deque>
#include <functional>
#include <optional>
#include <string>
#include <string_view>

#include "daemon/observability/log.hpp"

namespace slamgw {

// An event as systemd-journald takes it: one datagram of FIELD=value (systemd's "native journal
// protocol"). Pure.

/// The priority of syslog(3), as in `journalctl -p`: 3 error, 4 warning, 5 notice, 6 info, 7 debug.
int journal_priority(Severity severity);

/// Values may hold any octets. `program` is the name that `journalctl` shows in its lines.
std::string journal_entry(std::string_view program, Severity severity, std::string_view text,
                          const LogFields& fields);

/// Sends datagrams to systemd-journald without waiting: libsystemd's sd_journal_send() would block
/// the loop while the journal is stuck. Keeps entries that matter until the journal takes them and
/// counts the entries it loses. Loop's thread only.
class JournalSocket {
 public:
  /// Entries kept while the journal takes nothing; all further ones are lost.
  static constexpr std::size_t max_kept = 256;

  explicit JournalSocket(std::string path);
  ~JournalSocket();
  JournalSocket(const JournalSocket&) = delete;
  JournalSocket& operator=(const JournalSocket&) = delete;

  /// Keeps the order: no entry overtakes a kept one.
  void send(std::string entry, bool matters);
  /// Sends the kept entries. Returns true when none is left.
  bool flush();
  /// Returns the number of entries lost since the last call.
  std::uint64_t take_lost();

 private:
  enum class Result { taken, not_now, never };
  Result try_send(const std::string& entry) const;

  std::string path_;
  int socket_ = -1;
  std::deque<std::string> kept_;
  std::uint64_t lost_ = 0;
};

/// Facts about the message being written that spdlog cannot carry.
struct LogContext {
  Severity severity = Severity::info;
  const LogFields* fields = nullptr;
  std::function<void()> when_kept{};  ///< called when entries wait for the journal; may be empty
};

class JournalSink final : public spdlog::sinks::base_sink<spdlog::details::null_mutex> {
 public:
  /// `path`: the journal's socket.
  explicit JournalSink(const LogContext& context, std::string path = "/run/systemd/journal/socket")
      : context_(context), socket_(std::move(path)) {}

 private:
  static constexpr std::chrono::seconds lost_interval{1};

  void sink_it_(const spdlog::details::log_msg& message) override;
  /// Sends kept entries and reports lost ones. Called after each entry, and by LogRetry.
  void flush_() override;

  const LogContext& context_;
  JournalSocket socket_;
  std::uint64_t lost_ = 0;  ///< lost entries that are not reported yet
  std::optional<std::chrono::steady_clock::time_point> lost_reported_at_;
};

}  // namespace slamgw
